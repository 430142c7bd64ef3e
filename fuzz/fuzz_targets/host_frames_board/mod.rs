//! The board of `host_frames`: a load in closed form, so that heating is reached, or any samples.

use std::f64::consts::{PI, TAU};

use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::sampling::path::AdcBlock;
use ihd_firmware::sense::bus::BusReading;
use ihd_shared::sampling::{
    ADC_LOCK_P, ADC_LOCK_Q, AMPERE_PER_CODE, Pair, VOLT_PER_CODE, block_ns,
};

use super::reader::Reader;

const C_F: f64 = 1080e-9;

/// Kind of the samples.
enum Samples {
    /// A steady current through R and L at the drive's frequency, in ohm and henry.
    Load(f64, f64),
    /// The same pairs over and over.
    Repeated(Vec<Pair>),
}

/// Samples, mains and bus.
pub struct Board {
    samples: Samples,
    half_cycle_ns: u64,
    bus_peak_v: f64,
    /// Once: crossing, bus voltage and lost blocks of the next block, whatever the mains do.
    next: Option<(Option<u8>, u16, u32)>,
    time_ns: u64,
}

impl Default for Board {
    fn default() -> Self {
        Self {
            samples: Samples::Load(4.5, 26e-6),
            half_cycle_ns: 10_000_000,
            bus_peak_v: 325.0,
            next: None,
            time_ns: 0,
        }
    }
}

impl Board {
    /// Changes one thing.
    pub fn change(&mut self, reader: &mut Reader<'_>) {
        match reader.u8() % 8 {
            0 => {
                let r_ohm = reader.between(0.0, 16.0);
                self.samples = Samples::Load(r_ohm, reader.between(2e-6, 100e-6));
            }
            1 => {
                let count = usize::from(reader.u8() % 64) + 1;
                let pair = |reader: &mut Reader<'_>| Pair::from_le_bytes(reader.array());
                self.samples = Samples::Repeated((0..count).map(|_| pair(reader)).collect());
            }
            2 => {
                // Codes of 12 bits, as an ADC gives them.
                let code = |reader: &mut Reader<'_>| reader.u16() as i16 >> 4;
                let pair = |reader: &mut Reader<'_>| Pair {
                    v: code(reader),
                    i: code(reader),
                };
                let count = usize::from(reader.u8() % 64) + 1;
                self.samples = Samples::Repeated((0..count).map(|_| pair(reader)).collect());
            }
            // 100 ms to 4 ms.
            3 => self.half_cycle_ns = reader.between(4e6, 100e6) as u64,
            4 => self.bus_peak_v = reader.between(0.0, 450.0),
            5 => {
                let crossing = reader.u8().is_multiple_of(2).then(|| reader.u8());
                self.next = Some((crossing, reader.u16(), reader.u32()));
            }
            6 => *self = Self::default(),
            _ => {}
        }
    }

    /// The next block around its pairs; time goes on.
    pub fn block<'a>(&mut self, pairs: &'a [Pair; ADC_LOCK_P], drive: Drive) -> AdcBlock<'a> {
        let duration = u64::from(block_ns(drive.f_sw_hz));
        let next = (self.time_ns / self.half_cycle_ns + 1) * self.half_cycle_ns;
        let crosses = next <= self.time_ns + duration;
        let at = ((next - self.time_ns) * ADC_LOCK_P as u64).div_ceil(duration);
        let bus_dv = (self.bus_peak_v * self.envelope() * 10.0) as u16;
        self.time_ns += duration;
        let usual = (crosses.then_some(at as u8), bus_dv, 0);
        let (zero_crossing, bus_dv, lost) = self.next.take().unwrap_or(usual);
        AdcBlock {
            pairs,
            zero_crossing,
            bus: BusReading::steady(bus_dv),
            dc_link_ma: None,
            lost,
        }
    }

    fn envelope(&self) -> f64 {
        let phase = self.time_ns as f64 / self.half_cycle_ns as f64;
        (PI * phase).sin().abs()
    }

    /// The pairs of the next block.
    pub fn pairs(&self, drive: Drive) -> [Pair; ADC_LOCK_P] {
        match &self.samples {
            Samples::Load(r, l) if drive.is_switching() => {
                self.steady(f64::from(drive.f_sw_hz), *r, *l)
            }
            Samples::Load(..) => std::array::from_fn(|n| self.noise(n)),
            Samples::Repeated(pairs) => std::array::from_fn(|n| pairs[n % pairs.len()]),
        }
    }

    /// A code of noise, without which the samples count as frozen.
    fn noise(&self, n: usize) -> Pair {
        let bit = |n: usize| (self.time_ns >> (n % 23)) as i16 & 1;
        Pair {
            v: bit(n),
            i: bit(n + 7),
        }
    }

    /// I = V1 / Z, V = (R + jωL) I, the upper switch closing as the block begins, within the ADC's range.
    fn steady(&self, f_sw_hz: f64, r_ohm: f64, l_h: f64) -> [Pair; ADC_LOCK_P] {
        let x = TAU * f_sw_hz * l_h;
        let v1 = 2.0 / PI * self.bus_peak_v * self.envelope();
        let x_tank = x - (TAU * f_sw_hz * C_F).recip();
        let (i, at_i) = (
            v1 / r_ohm.hypot(x_tank).max(0.1),
            -0.5 * PI - x_tank.atan2(r_ohm),
        );
        let (v, at_v) = (i * r_ohm.hypot(x), at_i + x.atan2(r_ohm));
        std::array::from_fn(|n| {
            let turn = TAU * n as f64 * f64::from(ADC_LOCK_Q) / ADC_LOCK_P as f64;
            let code =
                |x: f64, noise: i16| (x.round() as i16).saturating_add(noise).clamp(-2048, 2047);
            let noise = self.noise(n);
            Pair {
                v: code(v * (turn + at_v).cos() / VOLT_PER_CODE, noise.v),
                i: code(i * (turn + at_i).cos() / AMPERE_PER_CODE, noise.i),
            }
        })
    }
}
