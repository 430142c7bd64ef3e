//! CDR encoding (ROS 2) of samples and truth: little-endian, every number aligned to its own size after a header of four bytes.
//! `topics` has the layouts.

use ihd_signal::ORDERS;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::vectorised::vectorised;

/// Header: CDR, little-endian, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Times of the samples of one message.
#[derive(Clone, Debug, PartialEq)]
pub enum BatchTime<'a> {
    /// Evenly spaced samples.
    Even {
        /// Time of the first pair in seconds.
        t0_s: f64,
        /// Time between two pairs in seconds.
        dt_s: f64,
    },
    /// Time of each pair in seconds.
    Stamps(&'a [f64]),
}

impl BatchTime<'_> {
    /// Time of the first pair in seconds.
    pub fn t0_s(&self) -> f64 {
        match *self {
            Self::Even { t0_s, .. } => t0_s,
            Self::Stamps(t_s) => t_s.first().copied().unwrap_or(0.0),
        }
    }
}

/// Pairs of one message.
#[derive(Clone, Debug, PartialEq)]
pub enum Pairs {
    /// ADC codes with their scales.
    Codes {
        /// Volt per voltage code.
        volt_per_code: f64,
        /// Ampere per current code.
        ampere_per_code: f64,
        /// Codes in the order v, i, v, i, …
        vi: Vec<i16>,
    },
    /// Volt and ampere in the order v, i, v, i, …
    Single(Vec<f32>),
}

/// One message of `/samples`.
#[derive(Clone, Debug, PartialEq)]
pub struct SamplesMessage {
    /// Time of the first pair in seconds.
    pub t0_s: f64,
    /// Time between two pairs in seconds; 0 with stamps.
    pub dt_s: f64,
    /// The pairs.
    pub pairs: Pairs,
    /// Time of each pair in seconds; empty if they are evenly spaced.
    pub t_s: Vec<f64>,
}

impl SamplesMessage {
    /// Number of pairs.
    pub fn len(&self) -> usize {
        match &self.pairs {
            Pairs::Codes { vi, .. } => vi.len() / 2,
            Pairs::Single(vi) => vi.len() / 2,
        }
    }

    /// Returns `true` if it holds no pair.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends all pairs to voltages in volt and currents in ampere.
    pub fn append_to(&self, columns: [&mut Vec<f32>; 2]) {
        for (k, column) in columns.into_iter().enumerate() {
            let from = column.len();
            column.resize(from + self.len(), 0.0);
            let column = &mut column[from..];
            match &self.pairs {
                Pairs::Codes {
                    volt_per_code,
                    ampere_per_code,
                    vi,
                } => {
                    let unit = [*volt_per_code, *ampere_per_code][k];
                    fill(column, vi, k, |code| (f64::from(code) * unit) as f32);
                }
                Pairs::Single(vi) => fill(column, vi, k, |x| x),
            }
        }
    }

    /// Time of pair `k` in seconds.
    pub fn at(&self, k: usize) -> f64 {
        match self.t_s.get(k) {
            Some(&t_s) => t_s,
            None => self.t0_s + k as f64 * self.dt_s,
        }
    }
}

/// Writes one value of each pair.
fn fill<T: Copy>(column: &mut [f32], vi: &[T], k: usize, of: impl Fn(T) -> f32) {
    vectorised(
        #[inline(always)]
        || {
            for (x, pair) in column.iter_mut().zip(vi.as_chunks::<2>().0) {
                *x = of(pair[k]);
            }
        },
    );
}

struct CdrWriter(Vec<u8>);

impl CdrWriter {
    fn new(capacity: usize) -> Self {
        let mut bytes = Vec::with_capacity(capacity + 2 * HEADER.len());
        bytes.extend(HEADER);
        Self(bytes)
    }

    fn align(&mut self, size: usize) {
        let used = self.0.len() - HEADER.len();
        let to = used.next_multiple_of(size) + HEADER.len();
        self.0.resize(to, 0);
    }

    fn double(&mut self, x: f64) {
        self.align(8);
        self.0.extend(x.to_le_bytes());
    }

    fn count(&mut self, n: usize) {
        self.align(4);
        self.0.extend((n as u32).to_le_bytes());
    }

    fn stamps(&mut self, t_s: &[f64]) {
        self.count(t_s.len());
        t_s.iter().for_each(|&t| self.double(t));
    }
}

fn begin(time: &BatchTime<'_>, pair_bytes: usize, pairs: usize) -> CdrWriter {
    let (dt_s, stamps) = match *time {
        BatchTime::Even { dt_s, .. } => (dt_s, 0),
        BatchTime::Stamps(t_s) => (0.0, t_s.len()),
    };
    let mut out = CdrWriter::new(64 + pairs * pair_bytes + 8 * stamps);
    out.double(time.t0_s());
    out.double(dt_s);
    out
}

fn end(mut out: CdrWriter, time: &BatchTime<'_>) -> Vec<u8> {
    match time {
        BatchTime::Even { .. } => out.stamps(&[]),
        BatchTime::Stamps(t_s) => out.stamps(t_s),
    }
    out.0
}

/// Encodes a message of codes; `pairs` yields v and i.
pub fn codes(
    time: &BatchTime<'_>,
    [volt_per_code, ampere_per_code]: [f64; 2],
    pairs: impl ExactSizeIterator<Item = [i16; 2]>,
) -> Vec<u8> {
    let mut out = begin(time, 4, pairs.len());
    out.double(volt_per_code);
    out.double(ampere_per_code);
    out.count(2 * pairs.len());
    pairs
        .flatten()
        .for_each(|code| out.0.extend(code.to_le_bytes()));
    end(out, time)
}

/// Encodes a message of volt and ampere; `pairs` yields v and i.
pub fn singles(time: &BatchTime<'_>, pairs: impl ExactSizeIterator<Item = [f32; 2]>) -> Vec<u8> {
    let mut out = begin(time, 8, pairs.len());
    out.count(2 * pairs.len());
    pairs.flatten().for_each(|x| out.0.extend(x.to_le_bytes()));
    end(out, time)
}

/// Encodes a message of `/truth`.
pub fn truth(t: &PeriodTruth) -> Vec<u8> {
    let mut out = CdrWriter::new(8 * (5 + 2 * ORDERS.len()));
    out.double(t.t_s);
    out.double(t.f_sw_hz);
    t.r_ohm.iter().for_each(|&r| out.double(r));
    t.l_h.iter().for_each(|&l| out.double(l));
    out.double(t.i_a);
    out.double(t.r_power_ohm);
    out.double(t.p_w);
    out.0
}

/// Error of decoding a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    /// The header is not little-endian CDR.
    #[error("it does not begin as little-endian CDR")]
    Header,
    /// The message is shorter than it declares.
    #[error("it is shorter than it declares")]
    Short,
    /// An odd number of values, or not one time per pair.
    #[error("its pairs and times do not match")]
    Uneven,
    /// A time is not finite, or the interval not above zero.
    #[error("its times are not finite, or do not ascend")]
    Time,
    /// A scale is not finite.
    #[error("its scales are not finite")]
    Scale,
}

struct CdrReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> CdrReader<'a> {
    fn new(message: &'a [u8]) -> Result<Self, CdrError> {
        let bytes = message.strip_prefix(&HEADER).ok_or(CdrError::Header)?;
        Ok(Self { bytes, at: 0 })
    }

    fn take(&mut self, bytes: usize, align: usize) -> Result<&'a [u8], CdrError> {
        let from = self.at.next_multiple_of(align);
        let end = from.checked_add(bytes).ok_or(CdrError::Short)?;
        let taken = self.bytes.get(from..end).ok_or(CdrError::Short)?;
        self.at = end;
        Ok(taken)
    }

    fn double(&mut self) -> Result<f64, CdrError> {
        let bytes = self.take(8, 8)?.try_into().map_err(|_| CdrError::Short)?;
        Ok(f64::from_le_bytes(bytes))
    }

    fn doubles<const N: usize>(&mut self) -> Result<[f64; N], CdrError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.double()?;
        }
        Ok(values)
    }

    fn array<const B: usize, T>(&mut self, from: fn([u8; B]) -> T) -> Result<Vec<T>, CdrError> {
        let count = self.take(4, 4)?.try_into().map_err(|_| CdrError::Short)?;
        let count = u32::from_le_bytes(count) as usize;
        if count == 0 {
            return Ok(Vec::new());
        }
        let length = count.checked_mul(B).ok_or(CdrError::Short)?;
        let (entries, _) = self.take(length, B)?.as_chunks::<B>();
        Ok(entries.iter().map(|&b| from(b)).collect())
    }
}

/// Decodes a message of `/samples`; `as_codes` selects one of its two layouts.
///
/// # Errors
/// [`CdrError`] when it is not of this layout.
pub fn read_samples(message: &[u8], as_codes: bool) -> Result<SamplesMessage, CdrError> {
    let mut input = CdrReader::new(message)?;
    let (t0_s, dt_s) = (input.double()?, input.double()?);
    let pairs = if as_codes {
        Pairs::Codes {
            volt_per_code: input.double()?,
            ampere_per_code: input.double()?,
            vi: input.array(i16::from_le_bytes)?,
        }
    } else {
        Pairs::Single(input.array(f32::from_le_bytes)?)
    };
    let t_s = input.array(f64::from_le_bytes)?;
    let values = match &pairs {
        Pairs::Codes { vi, .. } => vi.len(),
        Pairs::Single(vi) => vi.len(),
    };
    if !values.is_multiple_of(2) || !(t_s.is_empty() || t_s.len() == values / 2) {
        return Err(CdrError::Uneven);
    }
    let is_even = t_s.is_empty() && values > 2;
    if !t0_s.is_finite()
        || !dt_s.is_finite()
        || (is_even && dt_s <= 0.0)
        || t_s.iter().any(|t| !t.is_finite())
    {
        return Err(CdrError::Time);
    }
    if let Pairs::Codes {
        volt_per_code,
        ampere_per_code,
        ..
    } = pairs
        && !(volt_per_code.is_finite() && ampere_per_code.is_finite())
    {
        return Err(CdrError::Scale);
    }
    Ok(SamplesMessage {
        t0_s,
        dt_s,
        pairs,
        t_s,
    })
}

/// Decodes a message of `/truth`.
///
/// # Errors
/// [`CdrError`] when it is not of this layout.
pub fn read_truth(message: &[u8]) -> Result<PeriodTruth, CdrError> {
    let mut input = CdrReader::new(message)?;
    Ok(PeriodTruth {
        t_s: input.double()?,
        f_sw_hz: input.double()?,
        r_ohm: input.doubles()?,
        l_h: input.doubles()?,
        i_a: input.double()?,
        r_power_ohm: input.double()?,
        p_w: input.double()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_lie_where_the_documentation_says() {
        let time = BatchTime::Even {
            t0_s: 1.0,
            dt_s: 1e-6,
        };
        let message = codes(&time, [0.5, 0.25], [[1, -2], [3, 4]].into_iter());
        let double = |at: usize| f64::from_le_bytes(message[at..at + 8].try_into().unwrap());
        assert_eq!(
            [double(4), double(12), double(20), double(28)],
            [1.0, 1e-6, 0.5, 0.25]
        );
        assert_eq!(message[36..40], [4, 0, 0, 0]);
        assert_eq!(message[40..48], [1, 0, 0xfe, 0xff, 3, 0, 4, 0]);
        assert_eq!(message[48..], [0; 4], "no stamps");
    }

    #[test]
    fn stamps_are_aligned_to_eight_bytes_and_read_back() {
        let t_s = [0.0, 1e-6, 3e-6];
        let time = BatchTime::Stamps(&t_s);
        for (message, as_codes) in [
            (codes(&time, [1.0; 2], [[1, 2]; 3].into_iter()), true),
            (singles(&time, [[1.0, 2.0]; 3].into_iter()), false),
        ] {
            let back = read_samples(&message, as_codes).unwrap();
            assert_eq!(back.t_s, t_s);
            let [mut v_v, mut i_a] = [const { Vec::new() }; 2];
            back.append_to([&mut v_v, &mut i_a]);
            assert_eq!((v_v, i_a), (vec![1.0; 3], vec![2.0; 3]));
            assert_eq!(back.at(2), 3e-6);
        }
    }

    #[test]
    fn every_cut_message_is_refused() {
        let t_s = [0.0, 1e-6];
        let whole = codes(&BatchTime::Stamps(&t_s), [1.0; 2], [[1, 2]; 2].into_iter());
        for cut in 0..whole.len() {
            assert!(read_samples(&whole[..cut], true).is_err(), "{cut}");
        }
        let mut huge = whole.clone();
        huge[36..40].copy_from_slice(&[0xff; 4]);
        assert_eq!(read_samples(&huge, true), Err(CdrError::Short));
        let mut nan = whole;
        nan[4..12].copy_from_slice(&f64::NAN.to_le_bytes());
        assert_eq!(read_samples(&nan, true), Err(CdrError::Time));
        let even = |dt_s, volt_per_code| {
            let time = BatchTime::Even { t0_s: 0.0, dt_s };
            codes(&time, [volt_per_code, 1.0], [[1, 2]; 2].into_iter())
        };
        assert!(read_samples(&even(1e-6, -0.5), true).is_ok());
        for dt_s in [-1e-6, 0.0] {
            assert_eq!(read_samples(&even(dt_s, 0.5), true), Err(CdrError::Time));
        }
        let infinite = even(1e-6, f64::INFINITY);
        assert_eq!(read_samples(&infinite, true), Err(CdrError::Scale));
    }
}
