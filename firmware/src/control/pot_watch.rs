//! Watch over a pot that is heated: it may be lifted or pushed away from a sheet that lies below it.
//!
//! At the frequencies of heating household foil and thin lids have the R and L of some pot or other; which of the two stands there only
//! a pot probe shows ([`super::pot`]), for which the bridge opens. So one is due as soon as R or L, of the prior's, leaves what it was:
//! by 10 % in one half-cycle, or by 3.5 % in two. What a pot loses slowly is summed up until the next probe, so that one which is
//! drawn off within seconds counts as well, and one that gets warm costs a probe now and then. After half a minute one is due anyway: some
//! pot may have R and L of some sheet.
//!
//! Two causes change both without another load. With the frequency, as power is regulated, R and L of pots rise over the prior's by up to
//! half of its share, from 80 to 34 kHz; that is allowed for. With a mains that sags or swells the reference begins anew.
//!
//! By the field model, foil of 12 to 18 cm and lids of 8 to 14 cm in the place of ferritic pots of 15 to 21 cm, cast iron and a sandwich
//! base, at 1,000 to 2,500 W: 5 % at least, foil of 16 cm for a pot of 21 cm at 2,500 W; else 9 %. Noise of 20 dB, 1.5 % of R
//! (`noise/snr_20`, behavioural load), costs a probe in some seconds; of 25 dB none.

use crate::control::pot::of_prior;
use crate::sampling::half_cycle::HalfCycle;

/// Change of R or L over the prior's that counts, in permille.
const CHANGE_PERMILLE: i32 = 35;

/// Half-cycles in a row with such a change until a probe is due.
const CHANGED_HALF_CYCLES: u8 = 2;

/// Change for which one half-cycle is enough, in permille.
const LARGE_CHANGE_PERMILLE: i32 = 100;

/// R over the prior's, in 1e-4, from which on no sheet is as high: 79 % at most, foil of 16 cm at 40 kHz.
const PLAIN_POT_R: i32 = 9_000;

/// Frequencies further apart than this have a reference each, in permille.
const SAME_HZ_PERMILLE: i32 = 25;

/// Crests of the bus further apart than this are another mains, in permille.
const SAME_BUS_PERMILLE: i32 = 80;

/// Half-cycles of another mains after which it has the reference. A coil that loses its pot raises the bus for one.
const OTHER_BUS_HALF_CYCLES: u8 = 3;

/// Half-cycles whose mean the reference is.
const AVERAGED: u8 = 8;

/// Half-cycles of a reference from which on a change from it to the next is summed up: in a soft start each has another frequency.
const SETTLED: u8 = 3;

/// Longest time of heating without a probe, in milliseconds.
const UNPROBED_MS: u32 = 30_000;

/// R and L over the prior's, in 1e-4, and the conditions under which they were seen.
#[derive(Clone, Copy, Debug, Default)]
struct Reading {
    of_prior: [i32; 2],
    f_sw_hz: i32,
    bus_dv: i32,
}

/// R and L of the pot since the last probe.
#[derive(Clone, Debug)]
pub struct PotWatch {
    reference: Reading,
    /// Half-cycles in the reference's mean; 0 without a reference.
    averaged: u8,
    /// Changes of R and L between references since the last probe, in permille.
    changed_permille: [i32; 2],
    /// Half-cycles in a row that differ.
    different: u8,
    /// Half-cycles in a row of another mains.
    other_bus: u8,
    probed_ms: u32,
    is_probe_due: bool,
}

impl PotWatch {
    /// Begins with a pot that was probed now.
    pub fn new(now_ms: u32) -> Self {
        Self {
            reference: Reading::default(),
            averaged: 0,
            changed_permille: [0; 2],
            different: 0,
            other_bus: 0,
            probed_ms: now_ms,
            is_probe_due: false,
        }
    }

    /// Returns `true` if only a probe shows whether this is still a pot.
    pub fn is_probe_due(&self) -> bool {
        self.is_probe_due
    }

    /// Takes note of a probe. The reference stays: what stood there before it must stand there after it.
    pub fn probed(&mut self, now_ms: u32) {
        self.changed_permille = [0; 2];
        self.different = 0;
        self.probed_ms = now_ms;
        self.is_probe_due = false;
    }

    /// Takes an undisturbed half-cycle of heating.
    pub fn note(&mut self, summary: &HalfCycle, now_ms: u32) {
        self.is_probe_due |= now_ms.wrapping_sub(self.probed_ms) >= UNPROBED_MS;
        let (r, l) = of_prior(summary);
        let narrow = |x: i64| i32::try_from(x).unwrap_or(i32::MAX);
        let reading = Reading {
            of_prior: [narrow(r), narrow(l)],
            f_sw_hz: narrow(summary.f_sw_hz.into()),
            bus_dv: summary.bus_peak_dv.into(),
        };
        // Until the bridge opens: the half-cycle of the change may have had some of both loads.
        if self.averaged == 0 || self.is_probe_due {
            return self.begin(reading);
        }
        if permille(reading.bus_dv, self.reference.bus_dv).abs() > SAME_BUS_PERMILLE {
            self.other_bus += 1;
            if self.other_bus >= OTHER_BUS_HALF_CYCLES {
                self.begin(reading);
            }
            return;
        }
        self.other_bus = 0;
        let by_hz = permille(reading.f_sw_hz, self.reference.f_sw_hz);
        let changed = self.changed_until(&reading, by_hz);
        let largest = changed[0].abs().max(changed[1].abs());
        let may_be_sheet = reading.of_prior[0] < PLAIN_POT_R;
        self.different = if largest < CHANGE_PERMILLE || !may_be_sheet {
            0
        } else if largest < LARGE_CHANGE_PERMILLE {
            self.different + 1
        } else {
            CHANGED_HALF_CYCLES
        };
        if self.different >= CHANGED_HALF_CYCLES {
            self.different = 0;
            self.is_probe_due = true;
            self.begin(reading);
        } else if self.different == 0 && by_hz.abs() > SAME_HZ_PERMILLE {
            if self.averaged >= SETTLED {
                self.changed_permille = changed;
            }
            self.begin(reading);
        } else if self.different == 0 && self.averaged < AVERAGED {
            self.average(&reading);
        }
    }

    fn begin(&mut self, reading: Reading) {
        self.reference = reading;
        (self.averaged, self.other_bus) = (1, 0);
    }

    fn average(&mut self, reading: &Reading) {
        self.averaged += 1;
        for (mean, new) in self.reference.of_prior.iter_mut().zip(reading.of_prior) {
            *mean += new.saturating_sub(*mean) / i32::from(self.averaged);
        }
    }

    /// Changes of R and L since the last probe up to a reading whose frequency is higher by so much, in permille.
    fn changed_until(&self, reading: &Reading, by_hz: i32) -> [i32; 2] {
        let (least, most) = ((by_hz / 2).min(0), (by_hz / 2).max(0));
        let mut changed = self.changed_permille;
        let before = self.reference.of_prior;
        for (changed, (new, old)) in changed.iter_mut().zip(reading.of_prior.iter().zip(before)) {
            let by = permille(*new, old);
            *changed += by - by.clamp(least, most);
        }
        changed
    }
}

/// Excess of a quantity over another, in permille of that: a million at most.
fn permille(new: i32, old: i32) -> i32 {
    let (new, old) = (i64::from(new), i64::from(old.max(1)));
    ((new - old) * 1_000 / old).clamp(-1_000_000, 1_000_000) as i32
}

#[cfg(test)]
mod tests;
