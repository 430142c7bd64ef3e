//! Each run of an exception's handler: when it began, what it interrupted, and where its cycles went.

/// The runs of one exception's handler.
#[derive(Clone, Debug)]
pub struct Trace {
    exception: usize,
    interrupted: u32,
    blocks: Vec<(u32, u32)>,
    /// Those that have ended.
    pub runs: Vec<TracedRun>,
}

/// A run of a handler.
#[derive(Clone, Debug)]
pub struct TracedRun {
    /// When it began, in cycles since power-on.
    pub begun: u64,
    /// How long it took, in cycles.
    pub cycles: u64,
    /// Address of what it interrupted.
    pub interrupted: u32,
    /// Address and cycles of each block of code, in order.
    pub blocks: Vec<(u32, u32)>,
}

impl TracedRun {
    /// The `count` blocks of code that took most, as address and cycles of all their turns.
    pub fn most_at(&self, count: usize) -> Vec<(u32, u32)> {
        let mut sums = std::collections::BTreeMap::new();
        for &(address, cycles) in &self.blocks {
            *sums.entry(address).or_insert(0) += cycles;
        }
        let mut most: Vec<_> = sums.into_iter().collect();
        most.sort_by_key(|&(_, cycles)| std::cmp::Reverse(cycles));
        most.truncate(count);
        most
    }
}

impl Trace {
    /// Of the handler of an exception, by its number.
    pub fn of(exception: usize) -> Self {
        Self {
            exception,
            interrupted: 0,
            blocks: Vec::new(),
            runs: Vec::new(),
        }
    }

    /// Number of the exception.
    pub fn exception(&self) -> usize {
        self.exception
    }

    /// A handler begins, in place of what is at an address.
    pub fn begin(&mut self, exception: usize, interrupted: u32) {
        if exception == self.exception {
            self.interrupted = interrupted;
        }
    }

    /// A block of code of the handler has run.
    pub fn note(&mut self, address: u32, cycles: u32) {
        self.blocks.push((address, cycles));
    }

    /// A handler ends, so many cycles after it began.
    pub fn end(&mut self, exception: usize, begun: u64, cycles: u64) {
        if exception == self.exception {
            self.runs.push(TracedRun {
                begun,
                cycles,
                interrupted: self.interrupted,
                blocks: std::mem::take(&mut self.blocks),
            });
        }
    }
}
