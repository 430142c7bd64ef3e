//! Samples of one channel of a segment: doubles, or a capture's single-precision numbers less an offset. The latter are
//! converted only when all of them are needed at once: a second at 50 MS/s is 200 MB per channel in single precision.

use std::ops::{Deref, DerefMut, Range};
use std::sync::{Arc, OnceLock};

use crate::vectorised::vectorised;

/// Samples of one channel.
#[derive(Clone, Debug)]
pub struct Samples(Stored);

#[derive(Clone, Debug)]
enum Stored {
    Doubles(Vec<f64>),
    Singles(Singles),
}

/// Samples `samples[range]`, each less `offset`.
#[derive(Clone, Debug)]
struct Singles {
    samples: Arc<Vec<f32>>,
    range: Range<usize>,
    offset: f64,
    doubles: OnceLock<Vec<f64>>,
}

impl Singles {
    fn raw(&self) -> &[f32] {
        &self.samples[self.range.clone()]
    }

    fn to_doubles(&self) -> Vec<f64> {
        let less = |x: &f32| f64::from(*x) - self.offset;
        self.raw().iter().map(less).collect()
    }
}

/// Stored samples, without a copy.
#[derive(Clone, Copy, Debug)]
pub enum RawSamples<'a> {
    /// Double-precision samples.
    Doubles(&'a [f64]),
    /// Single-precision samples, and the offset to subtract from all of them.
    Singles(&'a [f32], f64),
}

impl Samples {
    /// Number of samples to convert to doubles at a time ([`Samples::block`]).
    pub const CHUNK: usize = 1 << 15;

    /// Stores single-precision samples without an offset.
    pub fn singles(samples: Vec<f32>) -> Self {
        Self::shared(Arc::new(samples))
    }

    /// Takes shared single-precision samples without an offset.
    pub fn shared(samples: Arc<Vec<f32>>) -> Self {
        let range = 0..samples.len();
        Self(Stored::Singles(Singles {
            samples,
            range,
            offset: 0.0,
            doubles: OnceLock::new(),
        }))
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        match &self.0 {
            Stored::Doubles(x) => x.len(),
            Stored::Singles(x) => x.range.len(),
        }
    }

    /// Returns `true` if there are no samples.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Stored form of the samples.
    pub fn raw(&self) -> RawSamples<'_> {
        match &self.0 {
            Stored::Doubles(x) => RawSamples::Doubles(x),
            Stored::Singles(x) => RawSamples::Singles(x.raw(), x.offset),
        }
    }

    /// Samples of a range as doubles; `buffer` is used if they must be converted.
    ///
    /// # Panics
    /// If the range reaches beyond the samples.
    pub fn block<'a>(&'a self, range: Range<usize>, buffer: &'a mut Vec<f64>) -> &'a [f64] {
        match &self.0 {
            Stored::Doubles(x) => &x[range],
            Stored::Singles(x) => {
                buffer.resize(range.len(), 0.0);
                let (raw, offset) = (&x.raw()[range], x.offset);
                vectorised(
                    #[inline(always)]
                    || {
                        for (y, x) in buffer.iter_mut().zip(raw) {
                            *y = f64::from(*x) - offset;
                        }
                    },
                );
                buffer
            }
        }
    }

    /// Returns the samples less `offset`, in the channel's unit.
    #[must_use]
    pub fn less(&self, offset: f64) -> Self {
        match &self.0 {
            Stored::Doubles(x) => x.iter().map(|x| x - offset).collect(),
            Stored::Singles(x) => Self(Stored::Singles(Singles {
                samples: Arc::clone(&x.samples),
                range: x.range.clone(),
                offset: x.offset + offset,
                doubles: OnceLock::new(),
            })),
        }
    }

    /// Returns the samples of a range, clamped to the existing ones.
    #[must_use]
    pub fn part(&self, range: Range<usize>) -> Self {
        let to = range.end.min(self.len());
        let from = range.start.min(to);
        match &self.0 {
            Stored::Doubles(x) => x[from..to].to_vec().into(),
            Stored::Singles(x) => Self(Stored::Singles(Singles {
                samples: Arc::clone(&x.samples),
                range: x.range.start + from..x.range.start + to,
                offset: x.offset,
                doubles: OnceLock::new(),
            })),
        }
    }
}

/// All samples as doubles, converted at the first use.
impl Deref for Samples {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        match &self.0 {
            Stored::Doubles(x) => x,
            Stored::Singles(x) => x.doubles.get_or_init(|| x.to_doubles()),
        }
    }
}

impl DerefMut for Samples {
    fn deref_mut(&mut self) -> &mut [f64] {
        if let Stored::Singles(x) = &self.0 {
            self.0 = Stored::Doubles(x.to_doubles());
        }
        match &mut self.0 {
            Stored::Doubles(x) => x,
            // Replaced just above.
            Stored::Singles(_) => &mut [],
        }
    }
}

impl Default for Samples {
    fn default() -> Self {
        Vec::new().into()
    }
}

impl From<Vec<f64>> for Samples {
    fn from(x: Vec<f64>) -> Self {
        Self(Stored::Doubles(x))
    }
}

impl FromIterator<f64> for Samples {
    fn from_iter<I: IntoIterator<Item = f64>>(x: I) -> Self {
        Vec::from_iter(x).into()
    }
}

impl Extend<f64> for Samples {
    fn extend<I: IntoIterator<Item = f64>>(&mut self, more: I) {
        let mut all = match std::mem::take(self).0 {
            Stored::Doubles(x) => x,
            Stored::Singles(x) => x.to_doubles(),
        };
        all.extend(more);
        *self = all.into();
    }
}

impl<'a> IntoIterator for &'a Samples {
    type Item = &'a f64;
    type IntoIter = std::slice::Iter<'a, f64>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl PartialEq for Samples {
    fn eq(&self, other: &Self) -> bool {
        let value = |raw: RawSamples<'_>, k: usize| match raw {
            RawSamples::Doubles(x) => x[k],
            RawSamples::Singles(x, offset) => f64::from(x[k]) - offset,
        };
        let (a, b) = (self.raw(), other.raw());
        self.len() == other.len() && (0..self.len()).all(|k| value(a, k) == value(b, k))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn singles_less_an_offset_are_the_doubles_that_they_stand_for() {
        let raw: Vec<f32> = (0..50).map(|k| k as f32 * 0.37).collect();
        let doubles: Samples = raw.iter().map(|x| f64::from(*x) - 1.5).collect();
        let singles = Samples::singles(raw).less(2.0).less(-0.5);
        assert_eq!(singles, doubles);
        assert_eq!(&*singles, &*doubles);
        let (mut a, mut b) = (Vec::new(), Vec::new());
        assert_eq!(singles.block(7..19, &mut a), doubles.block(7..19, &mut b));
        assert!(b.is_empty(), "doubles are there already");
        let (part, right) = (singles.part(10..40), doubles.part(10..40));
        assert_eq!(part, right);
        assert_eq!(part.part(25..99).len(), 5);
        assert_eq!(part.part(25..99), right.part(25..99));
    }

    #[test]
    fn what_is_changed_is_a_copy() {
        let singles = Samples::singles(vec![1.0, 2.0]);
        let mut changed = singles.less(1.0);
        changed[1] = 7.0;
        assert_eq!(*changed, [0.0, 7.0]);
        assert_eq!(*singles, [1.0, 2.0]);
    }
}
