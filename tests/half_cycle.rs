//! One mains half-cycle of sample pairs with the truth behind it (tests/fixtures/half_cycle).

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use ihd_shared::sampling::{ADC_LOCK_P, Pair, f_adc_hz};

/// Switching frequencies of the paper's Table 1, in hertz.
pub const F_SW_HZ: [u32; 4] = [45_000, 50_000, 60_000, 70_000];

/// A half-cycle at one switching frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct HalfCycle {
    /// Switching frequency in hertz.
    pub f_sw_hz: u32,
    /// Whole blocks of pairs from the mains zero crossing on.
    pub pairs: Vec<Pair>,
    /// (time after the zero crossing in seconds, R in ohm, L in henry).
    pub truth: Vec<(f64, f64, f64)>,
}

/// Folder of a fixture: `noiseless` or `snr30`.
fn path(f_sw_hz: u32, noise: &str, extension: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/half_cycle")
        .join(format!("{}k-{noise}.{extension}", f_sw_hz / 1000))
}

impl HalfCycle {
    /// Reads a fixture.
    ///
    /// # Errors
    /// When a file is missing or not of the format that [`HalfCycle::save`] writes.
    pub fn load(f_sw_hz: u32, noise: &str) -> io::Result<Self> {
        let bad = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
        let bytes = fs::read(path(f_sw_hz, noise, "pairs"))?;
        let pairs = bytes
            .chunks_exact(4)
            .map(|b| Pair::from_le_bytes([b[0], b[1], b[2], b[3]]))
            .collect();
        let truth = fs::read_to_string(path(f_sw_hz, noise, "truth.csv"))?
            .lines()
            .skip(1)
            .map(|line| {
                let mut numbers = line.split(',').map(str::parse::<f64>);
                let mut next = || numbers.next().and_then(Result::ok);
                Some((next()?, next()?, next()?))
            })
            .collect::<Option<_>>()
            .ok_or_else(|| bad("truth line without three numbers"))?;
        Ok(Self {
            f_sw_hz,
            pairs,
            truth,
        })
    }

    /// Writes a fixture: pairs as on the wire, truth as CSV.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn save(&self, noise: &str) -> io::Result<()> {
        let bytes: Vec<u8> = self.pairs.iter().flat_map(|p| p.to_le_bytes()).collect();
        fs::write(path(self.f_sw_hz, noise, "pairs"), bytes)?;
        let mut csv = String::from("t_s,r_ohm,l_h\n");
        for (t, r, l) in &self.truth {
            csv.push_str(&format!("{t:.6e},{r:.6},{l:.6e}\n"));
        }
        fs::write(path(self.f_sw_hz, noise, "truth.csv"), csv)
    }

    /// R and L at a time, linear between the points.
    pub fn at(&self, t_s: f64) -> (f64, f64) {
        let above = self.truth.partition_point(|p| p.0 < t_s);
        let above = above.clamp(1, self.truth.len() - 1);
        let (a, b) = (self.truth[above - 1], self.truth[above]);
        let w = ((t_s - a.0) / (b.0 - a.0)).clamp(0.0, 1.0);
        (a.1 + w * (b.1 - a.1), a.2 + w * (b.2 - a.2))
    }

    /// The pairs in blocks of p.
    pub fn blocks(&self) -> impl Iterator<Item = &[Pair; ADC_LOCK_P]> {
        self.pairs.as_chunks::<ADC_LOCK_P>().0.iter()
    }

    /// Duration of a block in seconds.
    pub fn block_s(&self) -> f64 {
        ADC_LOCK_P as f64 / f_adc_hz(self.f_sw_hz)
    }
}
