//! Recent events of mains and pot that may be undone in the next instant.
//!
//! - A mains that sags comes back: limits count at the bus voltage that it had, and while it is well
//!   below that, the power is not raised. One that was too high for less than ten seconds is what it was before.
//! - A pot that is lifted comes back: L has jumped up, and for two seconds the frequency stays where the
//!   pot was heated. It comes back to the power that it left.
//! - A soft limit acted: for 0.6 s the frequency stays above that place.

use ihd_shared::wire::messages::Limit;

use super::bounds::Bounds;
use crate::limits::{LIFT_REMEMBERED_MS, SAG_FORGOTTEN_MS, SAG_PERCENT, SOFT_REMEMBERED_MS};
use crate::sampling::half_cycle::HalfCycle;

/// A jump of L over the prior's within a half-cycle that is no drift: 4 %, 0.7 mm of lift.
const JUMP_Q10: u32 = 1_065;

/// A bus that was higher by this share was a swell.
const SWELL_PERCENT: u32 = 108;

/// A bus that has risen by more than this share for two half-cycles was low before: no swell, which the mains may have again. For one, it
/// was charged by a coil whose pot was lifted.
const MAX_SWELL_PERCENT: u32 = 125;

/// A frequency that must not be gone below, in hertz, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrequencyFloor {
    /// Frequency, in hertz; 0 for none.
    pub f_sw_hz: u32,
    /// Reason for the floor.
    pub limit: Limit,
}

fn is_sag(bus_dv: u16, of_dv: u16) -> bool {
    u32::from(bus_dv) * 100 < u32::from(of_dv) * SAG_PERCENT
}

/// Bus before a sag or a swell, and the lowest permitted frequency.
#[derive(Clone, Copy, Debug, Default)]
pub struct OperatingMemory {
    bus_dv: u16,
    /// Amplitude of the ripple that raised it, in decivolt.
    ripple_dv: u16,
    bus_seen_ms: u32,
    /// The bus before a swell, in decivolt, and the swell's beginning; 0 without one.
    before_swell_dv: u16,
    swell_since_ms: u32,
    /// L over the prior's of the last half-cycle, and its frequency.
    last: Option<(u32, u32)>,
    /// L over the prior's before it jumped; 0 when it has not.
    before_jump_q10: u32,
    floor: FrequencyFloor,
    floor_since_ms: u32,
    /// The bus above the floor, in decivolt; 0 before a whole half-cycle there. The current that led to it may have raised the bus.
    floor_bus_dv: u16,
}

impl OperatingMemory {
    /// Takes note of a half-cycle.
    pub fn note(&mut self, summary: &HalfCycle, now_ms: u32) {
        // A bridge that has just opened at the crest leaves the bus above any mains.
        if summary.f_sw_hz > 0 {
            self.note_bus(summary.bus_peak_dv, now_ms);
        }
        let lasts_ms = if self.before_jump_q10 > 0 {
            LIFT_REMEMBERED_MS
        } else {
            SOFT_REMEMBERED_MS
        };
        let is_old = now_ms.wrapping_sub(self.floor_since_ms) >= lasts_ms;
        // A swell that is over takes what it led to with it.
        let swell_is_over = self.floor.limit == Limit::Current
            && u32::from(summary.bus_peak_dv) * SWELL_PERCENT < u32::from(self.floor_bus_dv) * 100;
        if self.floor.f_sw_hz > 0 && (is_old || swell_is_over) {
            self.forget_floor();
        }
        if summary.f_sw_hz > 0 && summary.limit != Limit::None {
            self.last = None;
            self.raise_floor(summary.f_sw_hz, summary.limit, now_ms);
        } else if summary.disturbed || summary.f_sw_hz == 0 {
            self.last = None;
        } else {
            if self.floor_bus_dv == 0 {
                self.floor_bus_dv = summary.bus_peak_dv;
            }
            self.note_load(summary, now_ms);
        }
    }

    fn note_bus(&mut self, bus_dv: u16, now_ms: u32) {
        let is_above =
            |percent: u32, of_dv: u16| u32::from(bus_dv) * 100 > u32::from(of_dv) * percent;
        let is_near = |of_dv: u16| !is_sag(bus_dv, of_dv);
        if is_above(SWELL_PERCENT, self.bus_dv) {
            (self.before_swell_dv, self.swell_since_ms) = (self.bus_dv, now_ms);
        } else if is_above(MAX_SWELL_PERCENT, self.before_swell_dv) {
            self.before_swell_dv = 0;
        }
        let near = is_near(self.bus_dv);
        let swell_is_over = self.before_swell_dv > 0
            && now_ms.wrapping_sub(self.swell_since_ms) < SAG_FORGOTTEN_MS
            && is_near(self.before_swell_dv);
        let forgotten = now_ms.wrapping_sub(self.bus_seen_ms) >= SAG_FORGOTTEN_MS;
        if near {
            // Slowly after a mains that varies within what is no sag.
            self.bus_dv = bus_dv.max(self.bus_dv - self.bus_dv / 256);
            self.bus_seen_ms = now_ms;
        } else if swell_is_over {
            self.bus_dv = bus_dv.max(self.before_swell_dv);
            self.bus_seen_ms = now_ms;
            self.before_swell_dv = 0;
        } else if forgotten {
            self.bus_dv = bus_dv;
            self.bus_seen_ms = now_ms;
        }
    }

    /// Takes note of a small link's ripple, in decivolt, in the half-cycle that [`Self::note`] took; 0 with a larger link.
    ///
    /// The mains charges the link where the ripple is lowest, so that the bus is above the mains' crest by up to its amplitude: half
    /// of it counts.
    pub fn note_ripple(&mut self, summary: &HalfCycle, ripple_dv: u16) {
        if summary.bus_peak_dv >= self.bus_dv {
            self.ripple_dv = ripple_dv;
        }
    }

    fn note_load(&mut self, summary: &HalfCycle, now_ms: u32) {
        let l_q10 = Bounds::new(summary, summary.bus_peak_dv).l_q10();
        let f_sw_hz = summary.f_sw_hz;
        let above = |is: u32, than: u32| is << 10 > than * JUMP_Q10;
        if let Some((last_q10, last_hz)) = self.last
            // The prior's shape is not the load's: over a step of frequency a ratio may move.
            && last_hz.abs_diff(f_sw_hz) <= last_hz / 32
            && above(l_q10, last_q10)
        {
            if self.before_jump_q10 == 0 {
                self.before_jump_q10 = last_q10;
            }
            self.raise_floor(last_hz.max(f_sw_hz), Limit::Resonance, now_ms);
        } else if self.before_jump_q10 > 0 && !above(l_q10, self.before_jump_q10) {
            self.forget_floor();
        }
        self.last = Some((l_q10, f_sw_hz));
    }

    fn raise_floor(&mut self, f_sw_hz: u32, limit: Limit, now_ms: u32) {
        self.floor_bus_dv = 0;
        self.floor = FrequencyFloor { f_sw_hz, limit };
        self.floor_since_ms = now_ms;
    }

    fn forget_floor(&mut self) {
        self.floor = FrequencyFloor::default();
        self.before_jump_q10 = 0;
    }

    /// The bus voltage at the crest that limits count at, in decivolt.
    pub fn bus_dv(&self) -> u16 {
        self.bus_dv
    }

    /// Lowest frequency permitted after a half-cycle with a small link's ripple, in decivolt.
    pub fn floor_hz(&self, summary: &HalfCycle, ripple_dv: u16) -> FrequencyFloor {
        let mains_dv = |bus_dv: u16, ripple_dv: u16| bus_dv.saturating_sub(ripple_dv / 2);
        let sags = is_sag(
            mains_dv(summary.bus_peak_dv, ripple_dv),
            mains_dv(self.bus_dv, self.ripple_dv),
        );
        if sags && summary.f_sw_hz > self.floor.f_sw_hz {
            FrequencyFloor {
                f_sw_hz: summary.f_sw_hz,
                limit: Limit::Mains,
            }
        } else {
            self.floor
        }
    }

    /// Memory of the mains alone, for another pot.
    pub fn of_mains(&self) -> Self {
        Self {
            bus_dv: self.bus_dv,
            ripple_dv: self.ripple_dv,
            bus_seen_ms: self.bus_seen_ms,
            before_swell_dv: self.before_swell_dv,
            swell_since_ms: self.swell_since_ms,
            ..Self::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampling::half_cycle::CurrentCrest;
    use ihd_shared::units::{MicroOhm, PicoHenry};

    fn half_cycle(l_uh: f64, bus_dv: u16) -> HalfCycle {
        HalfCycle {
            f_sw_hz: 45_000,
            crest: CurrentCrest {
                r: MicroOhm(3_500_000),
                l: PicoHenry((l_uh * 1e6) as i32),
                i_ma: 30_000,
                ..CurrentCrest::default()
            },
            bus_peak_dv: bus_dv,
            ..HalfCycle::default()
        }
    }

    #[test]
    fn a_sag_holds_the_frequency_and_is_forgotten_after_ten_seconds() {
        let mut memory = OperatingMemory::default();
        memory.note(&half_cycle(24.0, 3_250), 0);
        let sag = half_cycle(24.0, 1_950);
        for ms in (10..10_000).step_by(10) {
            memory.note(&sag, ms);
            assert_eq!(
                (memory.bus_dv(), memory.floor_hz(&sag, 0).limit),
                (3_250, Limit::Mains)
            );
        }
        memory.note(&sag, 10_000);
        assert_eq!(
            (memory.bus_dv(), memory.floor_hz(&sag, 0)),
            (1_950, FrequencyFloor::default())
        );
    }

    /// 230 V, 274 V for 0.1 s, 230 V: the first half-cycle of it raises the power again, and a sag holds as before.
    #[test]
    fn a_swell_that_is_over_is_forgotten_at_once() {
        let mut memory = OperatingMemory::default();
        let (calm, swell) = (half_cycle(24.0, 3_253), half_cycle(24.0, 3_875));
        memory.note(&calm, 0);
        for ms in (10..110).step_by(10) {
            memory.note(&swell, ms);
            assert_eq!(memory.bus_dv(), 3_875);
        }
        memory.note(&calm, 110);
        assert_eq!(
            (memory.bus_dv(), memory.floor_hz(&calm, 0)),
            (3_253, FrequencyFloor::default())
        );
        let sag = half_cycle(24.0, 2_600);
        memory.note(&sag, 120);
        assert_eq!(memory.floor_hz(&sag, 0).limit, Limit::Mains);
        // A mains that recovers from a long sag and sags again may recover again.
        let mut memory = OperatingMemory::default();
        for (dv, ms) in [(2_500, 0), (3_253, 10), (3_253, 20), (2_500, 30)] {
            memory.note(&half_cycle(24.0, dv), ms);
        }
        assert_eq!(memory.bus_dv(), 3_253);
    }

    /// Lifted at the crest, a pot leaves the coil's energy in C2: 407 V for one half-cycle at 228 V.
    #[test]
    fn a_bus_that_a_lifted_pot_has_charged_is_no_mains() {
        let mut memory = OperatingMemory::default();
        let mains = half_cycle(24.0, 3_225);
        for (dv, ms) in [(3_225, 0), (3_225, 10), (4_071, 20)] {
            memory.note(&half_cycle(24.0, dv), ms);
        }
        memory.note(&mains, 30);
        assert_eq!(
            (memory.bus_dv(), memory.floor_hz(&mains, 0)),
            (3_225, FrequencyFloor::default())
        );
    }

    #[test]
    fn a_lifted_pot_holds_the_frequency_until_it_is_back() {
        let mut memory = OperatingMemory::default();
        memory.note(&half_cycle(24.0, 3_250), 0);
        assert_eq!(
            memory.floor_hz(&half_cycle(24.0, 3_250), 0),
            FrequencyFloor::default()
        );
        for ms in (10..1_000).step_by(10) {
            let lifted = half_cycle(31.0, 3_250);
            memory.note(&lifted, ms);
            assert_eq!(memory.floor_hz(&lifted, 0).f_sw_hz, 45_000);
        }
        let back = half_cycle(24.1, 3_250);
        memory.note(&back, 1_000);
        assert_eq!(memory.floor_hz(&back, 0), FrequencyFloor::default());
    }

    #[test]
    fn a_soft_limit_is_remembered_for_a_while() {
        let mut memory = OperatingMemory::default();
        let limited = HalfCycle {
            limit: Limit::Current,
            disturbed: true,
            f_sw_hz: 48_000,
            ..half_cycle(24.0, 3_250)
        };
        memory.note(&limited, 0);
        let floor = memory.floor_hz(&half_cycle(24.0, 3_250), 0);
        assert_eq!((floor.f_sw_hz, floor.limit), (48_000, Limit::Current));
        memory.note(&half_cycle(24.0, 3_250), SOFT_REMEMBERED_MS);
        assert_eq!(
            memory.floor_hz(&half_cycle(24.0, 3_250), 0),
            FrequencyFloor::default()
        );
    }

    /// 1 µF, 40 A: the ripple's 70 V are in the bus of 395 V. The calm bus of a start is the same mains, and a real sag is one.
    #[test]
    fn a_bus_that_the_coil_swings_is_the_calm_mains() {
        let mut memory = OperatingMemory::default();
        let loaded = half_cycle(24.0, 3_950);
        memory.note(&loaded, 0);
        memory.note_ripple(&loaded, 700);
        let mut memory = memory.of_mains();
        // 150 V of 230: 212 V and a ripple of 45.
        let sag = half_cycle(24.0, 2_570);
        assert_eq!(memory.floor_hz(&sag, 450).limit, Limit::Mains);
        let start = half_cycle(24.0, 3_250);
        memory.note(&start, 10);
        memory.note_ripple(&start, 250);
        assert_eq!(memory.floor_hz(&start, 250), FrequencyFloor::default());
        // More power again: near the bus that is remembered, which had another ripple.
        let half = half_cycle(24.0, 3_500);
        memory.note(&half, 20);
        memory.note_ripple(&half, 500);
        assert_eq!(memory.floor_hz(&half, 500), FrequencyFloor::default());
        memory.note(&sag, 30);
        memory.note_ripple(&sag, 450);
        assert_eq!(memory.floor_hz(&sag, 450).limit, Limit::Mains);
    }

    /// A trip at the crest charges the link to 500 V; the mains of before is no sag.
    #[test]
    fn the_bus_of_an_open_bridge_is_no_mains() {
        let mut memory = OperatingMemory::default();
        memory.note(&half_cycle(24.0, 3_250), 0);
        let tripped = HalfCycle {
            f_sw_hz: 0,
            ..half_cycle(24.0, 5_000)
        };
        memory.note(&tripped, 10);
        let back = half_cycle(24.0, 3_250);
        memory.note(&back, 20);
        assert_eq!(memory.floor_hz(&back, 0), FrequencyFloor::default());
    }
}
