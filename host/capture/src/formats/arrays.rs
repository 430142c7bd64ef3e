//! Files of named arrays (MAT, NPZ): choice of the time and of the channels.
//!
//! Time is a vector named like it, or start and interval as scalars; channels are the vectors as
//! long as the time, or without one the longest. Units are taken from names (`v_V`, `time_us`).

use std::collections::BTreeMap;

use ihd_signal::truth::PeriodTruth;
use ihd_signal::{FrequencyStep, ORDERS, TimeBase};

use super::stated_unit::StatedUnit;
use super::time::{binary_resolution, is_time_name, time_base};
use super::{CaptureFile, FileChannel, FileFacts, FileSamples, ReadProgress};
use crate::error::FormatError;
use crate::options::ReadOptions;

/// One array, as the file's directory describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Its name.
    pub name: String,
    /// Number of elements of a vector; 0 for a matrix and for anything that is not numeric.
    pub length: u64,
    /// Offset in the file, for messages.
    pub offset: u64,
    /// Value of an array with one element.
    pub scalar: Option<f64>,
    /// A short text.
    pub text: Option<String>,
}

/// Access to the numbers of arrays.
pub trait Arrays {
    /// Passes all numbers of array `index` to `each`.
    ///
    /// # Errors
    /// [`FormatError`] when they are not all there.
    fn numbers(&mut self, index: usize, each: &mut dyn FnMut(f64)) -> Result<(), FormatError>;
}

/// Arrays as a source of channels.
pub struct ArraySource<A> {
    reader: A,
    arrays: Vec<Array>,
    /// Index of each channel's array.
    columns: Vec<usize>,
    channels: Vec<FileChannel>,
    clock: Clock,
    metadata: BTreeMap<String, String>,
}

enum Clock {
    Array { index: usize, scale: f64 },
    Even { t0_s: f64, dt_s: f64 },
    Missing,
}

/// Prefix of the arrays that hold a simulation's truth.
const TRUTH: &str = "truth_";
/// Names of the sampling interval, in lower case: ours, Tektronix', PicoScope's.
const INTERVAL: [&str; 5] = [
    "dt",
    "sampleinterval",
    "tinterval",
    "sample_interval",
    "xincr",
];
/// Names of the first sample's time.
const START: [&str; 4] = ["t0", "tstart", "start", "xzero"];
/// Names of the sampling rate.
const RATE: [&str; 5] = ["fs", "f_s", "samplerate", "sample_rate", "rate"];

/// Name without its unit, and the unit.
fn heading(array: &Array) -> (String, StatedUnit) {
    StatedUnit::of_heading(&array.name)
}

/// Indices of the time vector, if there is one, and of the vectors that are as long.
///
/// # Errors
/// [`FormatError`] when there are no two channels.
fn vectors(arrays: &[Array]) -> Result<(Option<usize>, Vec<usize>), FormatError> {
    let is_time = |a: &Array| {
        let (name, unit) = heading(a);
        a.length > 1 && is_time_name(&name) && unit.seconds().is_ok()
    };
    let time = arrays.iter().position(is_time);
    let is_truth = |a: &Array| a.name.starts_with(TRUTH);
    let longest = arrays
        .iter()
        .filter(|a| !is_truth(a))
        .map(|a| a.length)
        .max();
    let length = time.map_or(longest.unwrap_or(0), |k| arrays[k].length);
    let others = || (0..arrays.len()).filter(|k| Some(*k) != time && !is_truth(&arrays[*k]));
    let columns: Vec<usize> = others().filter(|k| arrays[*k].length == length).collect();
    let is_passed_over = |k: usize| {
        let a = &arrays[k];
        a.length != length && a.scalar.is_none() && a.text.is_none()
    };
    let few = columns.is_empty() || (columns.len() == 1 && others().any(is_passed_over));
    if length >= 2 && !few {
        return Ok((time, columns));
    }
    let described = |a: &Array| match a.length {
        0 | 1 => format!("`{}` is none", a.name),
        n => format!("`{}` has {n}", a.name),
    };
    let list: Vec<_> = arrays.iter().take(12).map(described).collect();
    let what = format!(
        "no two channels: save each as a vector of real numbers, of one length, 32 or 64 bit or integers; {}",
        list.join(", ")
    );
    Err(FormatError::at_byte(0, what))
}

impl<A: Arrays> ArraySource<A> {
    /// Finds clock and channels among `arrays`.
    ///
    /// # Errors
    /// [`FormatError`] when there is no vector.
    pub fn new(
        reader: A,
        arrays: Vec<Array>,
        format: &str,
        options: ReadOptions<'_>,
    ) -> Result<Self, FormatError> {
        let (time, columns) = vectors(&arrays)?;
        let clock = match time {
            _ if options.without_times => Clock::Missing,
            Some(index) => Clock::Array {
                index,
                scale: heading(&arrays[index]).1.seconds().unwrap_or(1.0),
            },
            None => clock_of_scalars(&arrays),
        };
        // Tektronix' MAT has one vector, and its unit as a text.
        let text_of = |name: &str| {
            let array = arrays.iter().find(|a| a.name.eq_ignore_ascii_case(name));
            array.and_then(|a| a.text.as_deref())
        };
        let unit_stated = text_of("verticalUnits").filter(|_| columns.len() == 1);
        let channel = |k: &usize| {
            let (name, unit) = heading(&arrays[*k]);
            // Our own `v_full_scale_V` of `v_V`.
            let full_scale = (format!("{name}_full_scale"), unit.clone());
            let full_scale = arrays.iter().find(|a| heading(a) == full_scale);
            FileChannel {
                name,
                unit: unit.or_else(|| StatedUnit::parse(unit_stated.unwrap_or_default())),
                full_scale: full_scale.and_then(|a| a.scalar).filter(|x| *x > 0.0),
            }
        };
        let texts = arrays
            .iter()
            .filter_map(|a| Some((a.name.clone(), a.text.clone()?)));
        let mut metadata: BTreeMap<_, _> = texts.collect();
        metadata.insert("format".to_owned(), format.to_owned());
        Ok(Self {
            channels: columns.iter().map(channel).collect(),
            reader,
            columns,
            clock,
            metadata,
            arrays,
        })
    }

    /// Reads the truth of a simulation; empty if any of its arrays is missing.
    fn truth(&mut self) -> Result<Vec<PeriodTruth>, FormatError> {
        let [
            Some(t_s),
            Some(f_sw_hz),
            Some(i_a),
            Some(r_power_ohm),
            Some(p_w),
        ] = [
            self.column("truth_t_s")?,
            self.column("truth_f_sw_hz")?,
            self.column("truth_i_a")?,
            self.column("truth_r_power_ohm")?,
            self.column("truth_p_w")?,
        ]
        else {
            return Ok(Vec::new());
        };
        let (Some(r_ohm), Some(l_h)) = (self.column("truth_r_ohm")?, self.column("truth_l_h")?)
        else {
            return Ok(Vec::new());
        };
        let (r_ohm, rest_r) = r_ohm.as_chunks::<{ ORDERS.len() }>();
        let (l_h, rest_l) = l_h.as_chunks::<{ ORDERS.len() }>();
        let n = t_s.len();
        let lengths = [f_sw_hz.len(), i_a.len(), r_power_ohm.len(), p_w.len()];
        let of_orders = [r_ohm.len(), l_h.len()];
        let whole = rest_r.is_empty() && rest_l.is_empty();
        if !whole || lengths.iter().chain(&of_orders).any(|length| *length != n) {
            let what = "the arrays truth_* are of different length: save all or none of them";
            return Err(FormatError::at_byte(0, what));
        }
        let period = |k: usize| PeriodTruth {
            t_s: t_s[k],
            f_sw_hz: f_sw_hz[k],
            r_ohm: r_ohm[k],
            l_h: l_h[k],
            i_a: i_a[k],
            r_power_ohm: r_power_ohm[k],
            p_w: p_w[k],
        };
        Ok((0..n).map(period).collect())
    }

    /// Reads all numbers of the named array, row by row; `None` if there is none.
    fn column(&mut self, name: &str) -> Result<Option<Vec<f64>>, FormatError> {
        let Some(index) = self.arrays.iter().position(|a| a.name == name) else {
            return Ok(None);
        };
        let mut numbers = Vec::new();
        // Impedance is undefined without current: values that are not finite are allowed.
        self.reader.numbers(index, &mut |x| numbers.push(x))?;
        Ok(Some(numbers))
    }

    /// Reads the stamps of a time vector; `keep` is called with each number.
    ///
    /// # Errors
    /// [`FormatError`] when they are not all there, or at the first that is not finite.
    fn stamps(&mut self, index: usize, mut keep: impl FnMut(f64)) -> Result<(), FormatError> {
        let mut bad = None;
        let mut k = 0u64;
        self.reader.numbers(index, &mut |x| {
            if !x.is_finite() && bad.is_none() {
                bad = Some(k);
            }
            k += 1;
            keep(x);
        })?;
        match bad {
            None => Ok(()),
            Some(k) => {
                let array = &self.arrays[index];
                let what = format!("number {k} of `{}` is not finite", array.name);
                Err(FormatError::at_byte(array.offset, what))
            }
        }
    }
}

/// Start and interval from scalars, in seconds by name or unit.
fn clock_of_scalars(arrays: &[Array]) -> Clock {
    let scalar = |names: &[&str]| {
        arrays.iter().find_map(|a| {
            let (name, unit) = heading(a);
            let whole = a.name.to_lowercase();
            let known = |n: &str| names.contains(&n);
            let named = known(&name.to_lowercase()) || known(&whole);
            let value = a.scalar.filter(|x| named && x.is_finite())?;
            Some(value * unit.known().map_or(1.0, |u| u.scale))
        })
    };
    let rate = scalar(&RATE).filter(|hz| *hz > 0.0).map(|hz| 1.0 / hz);
    match scalar(&INTERVAL).filter(|dt| *dt > 0.0).or(rate) {
        Some(dt_s) => Clock::Even {
            t0_s: scalar(&START).unwrap_or(0.0),
            dt_s,
        },
        None => Clock::Missing,
    }
}

impl<A: Arrays> CaptureFile for ArraySource<A> {
    fn channels(&self) -> &[FileChannel] {
        &self.channels
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        self.metadata.clone()
    }

    fn facts(&mut self) -> Result<FileFacts, FormatError> {
        let scalar = |name: &str| {
            let array = self.arrays.iter().find(|a| a.name == name)?;
            array.scalar.filter(|x| x.is_finite())
        };
        let (mains_hz, zero_crossing_s) = (scalar("mains_hz"), scalar("zero_crossing_s"));
        let at_s = self.column("f_sw_t_s")?.unwrap_or_default();
        let f_sw_hz = self.column("f_sw_hz")?.unwrap_or_default();
        let step = |(t_s, f_sw_hz)| FrequencyStep { t_s, f_sw_hz };
        Ok(FileFacts {
            truth: self.truth()?,
            f_sw: at_s.into_iter().zip(f_sw_hz).map(step).collect(),
            mains_hz,
            zero_crossing_s,
        })
    }

    fn read(
        &mut self,
        selected: &[usize],
        progress: ReadProgress<'_>,
    ) -> Result<FileSamples, FormatError> {
        let time =
            match self.clock {
                Clock::Missing => None,
                Clock::Even { t0_s, dt_s } => Some(TimeBase::Even { t0_s, dt_s }),
                Clock::Array { index, scale } => {
                    let length = self.arrays[index].length as usize;
                    let mut stamps = Vec::with_capacity(length.min(RESERVED));
                    self.stamps(index, |t| stamps.push(t))?;
                    let resolution_s = binary_resolution(&stamps) * scale;
                    stamps.iter_mut().for_each(|t| *t *= scale);
                    let base = time_base(stamps, resolution_s, None);
                    Some(base.map_err(|e| {
                        FormatError::at_byte(self.arrays[index].offset, e.to_string())
                    })?)
                }
            };
        let mut columns = Vec::with_capacity(selected.len());
        for (done, channel) in selected.iter().enumerate() {
            progress(done as f64 / selected.len() as f64);
            let Some(&index) = self.columns.get(*channel) else {
                continue;
            };
            let length = self.arrays[index].length as usize;
            let mut values = Vec::with_capacity(length.min(RESERVED));
            // Samples that are not finite stay so: the survey cuts the capture there.
            self.reader.numbers(index, &mut |x| values.push(x as f32))?;
            columns.push(values);
        }
        Ok(FileSamples { time, columns })
    }
}

/// Numbers allocated in advance at most: a declared length may be wrong.
const RESERVED: usize = 1 << 16;

/// Largest accepted compression ratio of arrays above [`ANY_RATIO_BELOW_BYTES`]: samples with noise reach 20, deflate's limit is 1032.
const MAX_RATIO: u64 = 256;

/// Size in bytes below which any compression ratio is accepted.
const ANY_RATIO_BELOW_BYTES: u64 = 1 << 24;

/// Returns `true` if `packed` bytes can plausibly unpack to `unpacked` bytes; this bounds memory.
pub fn plausible(packed: u64, unpacked: u64) -> bool {
    unpacked <= ANY_RATIO_BELOW_BYTES || unpacked / MAX_RATIO <= packed
}

#[cfg(test)]
mod tests {
    use super::*;

    struct NoNumbers;

    impl Arrays for NoNumbers {
        fn numbers(&mut self, _: usize, _: &mut dyn FnMut(f64)) -> Result<(), FormatError> {
            Ok(())
        }
    }

    fn channels(arrays: &[(&str, u64)]) -> Result<usize, String> {
        let arrays = arrays.iter().map(|(name, length)| Array {
            name: (*name).to_owned(),
            length: *length,
            offset: 0,
            scalar: (*length == 1).then_some(1e-6),
            text: None,
        });
        ArraySource::new(NoNumbers, arrays.collect(), "test", ReadOptions::default())
            .map(|source| source.channels.len())
            .map_err(|error| error.to_string())
    }

    #[test]
    fn an_array_that_does_not_fit_is_named_and_not_passed_over_in_silence() {
        assert_eq!(
            channels(&[("v", 9), ("i", 9), ("dt", 1), ("window", 4)]),
            Ok(2)
        );
        assert_eq!(
            channels(&[("v", 9), ("dt", 1)]),
            Ok(1),
            "the other file has i"
        );
        let short = channels(&[("t", 9), ("v", 8), ("i", 9)]).unwrap_err();
        assert!(short.contains("`v` has 8, `i` has 9"), "{short}");
        let complex = channels(&[("t", 9), ("v", 0), ("i", 0)]).unwrap_err();
        assert!(complex.contains("`v` is none, `i` is none"), "{complex}");
    }
}
