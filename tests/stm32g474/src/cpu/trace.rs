//! Trace of an exception's handler: start of each run, interrupted code, and cycles of each block of code.

/// Runs of one exception's handler.
#[derive(Clone, Debug)]
pub struct Trace {
    exception: usize,
    interrupted: u32,
    blocks: Vec<(u32, u32)>,
    /// Completed runs.
    pub runs: Vec<TracedRun>,
}

/// Run of a handler.
#[derive(Clone, Debug)]
pub struct TracedRun {
    /// Start, in cycles since power-on.
    pub begun: u64,
    /// Duration in cycles.
    pub cycles: u64,
    /// Address of the interrupted code.
    pub interrupted: u32,
    /// Address and cycles of each block of code, in order.
    pub blocks: Vec<(u32, u32)>,
}

impl TracedRun {
    /// The `count` blocks of code with the most cycles: address, and cycles of all their executions.
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
    /// Trace of the handler of an exception, by its number.
    pub fn new(exception: usize) -> Self {
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

    /// Records the start of a handler and the address that it interrupts.
    pub fn begin(&mut self, exception: usize, interrupted: u32) {
        if exception == self.exception {
            self.interrupted = interrupted;
        }
    }

    /// Records an executed block of code of the handler.
    pub fn note(&mut self, address: u32, cycles: u32) {
        self.blocks.push((address, cycles));
    }

    /// Records the end of a handler, with its start and duration in cycles.
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
