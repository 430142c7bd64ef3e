//! Sharing of a supply with a second zone, which has a controller of its own, over one wire.
//!
//! A zone pulls the wire low while it draws power, and draws power only while it pulls. So one zone at a time does: no beat of two
//! switching frequencies, and never more than one zone's power from the supply. While both are on, each gives its energy in
//! bursts of whole mains cycles ([`super::burst`]). The power of a burst is lowered until one burst follows the other, so that the
//! supply's current stays; it follows from the time for which the wire is low, which both zones see alike.
//!
//! A resistor on one of the two boards pulls the wire up, each chip weakly down. A board whose wire was never high shares
//! nothing. A wire that breaks later leaves the zone with the resistor alone, and the other without power.

use ihd_shared::hob::RATED_POWER_W;

use crate::limits::{BURST_PERIOD_MS, BURST_POWER_W, OFFER_MS, OTHER_ZONE_SILENT_MS};

/// Readings of a high wire in a row, one a millisecond, after which it is there.
const FITTED_READINGS: u8 = 100;

/// Share of the time with a low wire above which it is always low: a handover takes a millisecond or two.
const BUSY_PERCENT: u16 = 99;

/// Rise of a burst's power in a period when the wire is always low, and largest fall when it is not.
const RISE_PERCENT: u32 = 2;
const FALL_PERCENT: u32 = 5;

/// Time from a claim to the first offer, in milliseconds.
const FIRST_OFFER_MS: u16 = 500;

/// Claim on the supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Claim {
    None,
    /// Until the wire is free.
    Wanted,
    Held,
}

/// The wire, and the other zone behind it.
#[derive(Clone, Debug)]
pub struct SupplyShare {
    /// Time of the last reading.
    read_ms: u32,
    /// Readings of a high wire in a row, up to [`FITTED_READINGS`].
    high: u8,
    claim: Claim,
    /// This zone has pulled since the last reading, which then shows nothing else.
    pulls: bool,
    /// Noise of the measured power: two boards that were switched on together differ in it.
    noise: u8,
    /// Time since the other zone pulled.
    silent_ms: u16,
    /// Time of this period, and its part with a low wire.
    counted_ms: u16,
    low_ms: u16,
    /// Time of this period at which the wire is offered.
    offer_ms: u16,
    burst_w: u16,
}

impl Default for SupplyShare {
    fn default() -> Self {
        Self {
            read_ms: 0,
            high: 0,
            claim: Claim::None,
            pulls: false,
            noise: 0,
            silent_ms: u16::MAX,
            counted_ms: 0,
            low_ms: 0,
            offer_ms: 0,
            burst_w: RATED_POWER_W,
        }
    }
}

impl SupplyShare {
    /// Takes the wire's level, every millisecond or more often; returns `true` if this zone pulls it low from now on.
    pub fn exchange(&mut self, is_high: bool, now_ms: u32) -> bool {
        let elapsed_ms = now_ms.wrapping_sub(self.read_ms).min(100) as u16;
        if elapsed_ms == 0 {
            return self.pulls;
        }
        self.read_ms = now_ms;
        if !self.is_fitted() {
            self.high = if is_high { self.high + 1 } else { 0 };
            return false;
        }
        let other_pulls = !self.pulls && !is_high;
        self.silent_ms = if other_pulls {
            0
        } else {
            self.silent_ms.saturating_add(elapsed_ms)
        };
        self.claim = match self.claim {
            // It has taken what was offered.
            Claim::Held if other_pulls => Claim::None,
            Claim::Wanted if !self.pulls && is_high => {
                // What it has just got it does not offer.
                self.offer_ms = self.counted_ms + FIRST_OFFER_MS;
                Claim::Held
            }
            claim => claim,
        };
        self.count(elapsed_ms, self.pulls || other_pulls);
        // The other zone cannot say that it waits but by pulling a wire that is free.
        let offers = !self.is_shared()
            && (self.offer_ms..self.offer_ms + OFFER_MS).contains(&self.counted_ms);
        self.pulls = self.claim == Claim::Held && !offers;
        self.pulls
    }

    fn count(&mut self, elapsed_ms: u16, is_low: bool) {
        self.counted_ms += elapsed_ms;
        if is_low {
            self.low_ms += elapsed_ms;
        }
        if u32::from(self.counted_ms) < BURST_PERIOD_MS {
            return;
        }
        let (low, all) = (u32::from(self.low_ms), u32::from(self.counted_ms));
        let burst_w = u32::from(self.burst_w);
        let next_w = if !self.is_shared() {
            u32::from(RATED_POWER_W)
        } else if low * 100 >= all * u32::from(BUSY_PERCENT) {
            burst_w * (100 + RISE_PERCENT) / 100
        } else {
            burst_w * (100 * low / all).max(100 - FALL_PERCENT) / 100
        };
        self.burst_w = next_w.clamp(u32::from(BURST_POWER_W), u32::from(RATED_POWER_W)) as u16;
        (self.counted_ms, self.low_ms) = (0, 0);
        self.offer_ms = 3 * u16::from(self.noise);
    }

    /// Claims the supply, as long as this zone is to draw power; returns `true` once it has it.
    pub fn claim(&mut self) -> bool {
        if self.claim == Claim::None {
            self.claim = Claim::Wanted;
        }
        self.holds()
    }

    /// Takes the power of a half-cycle, in milliwatt, for its noise.
    pub fn note(&mut self, power_mw: u32) {
        self.noise = self.noise.rotate_left(3) ^ power_mw as u8;
    }

    /// Leaves the supply to the other zone, which then begins [`crate::limits::HANDOVER_HALF_CYCLES`] later.
    pub fn release(&mut self) {
        self.claim = Claim::None;
    }

    /// Returns `true` if this zone may draw power.
    pub fn holds(&self) -> bool {
        !self.is_fitted() || self.claim == Claim::Held
    }

    /// Returns `true` while the other zone is on.
    pub fn is_shared(&self) -> bool {
        self.is_fitted() && self.silent_ms < OTHER_ZONE_SILENT_MS
    }

    /// Power of a burst while the supply is shared, in watt.
    pub fn burst_w(&self) -> u16 {
        self.burst_w
    }

    fn is_fitted(&self) -> bool {
        self.high >= FITTED_READINGS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two zones with a wire that was there long enough, stepped by milliseconds in which both read before either pulls.
    struct Wire {
        zones: [SupplyShare; 2],
        now_ms: u32,
    }

    impl Wire {
        fn new() -> Self {
            let mut wire = Self {
                zones: [SupplyShare::default(), SupplyShare::default()],
                // The clock wraps on the way.
                now_ms: u32::MAX - 200,
            };
            (0..=FITTED_READINGS).for_each(|_| wire.step());
            wire
        }

        fn step(&mut self) {
            self.now_ms = self.now_ms.wrapping_add(1);
            let is_high = self.zones.iter().all(|zone| !zone.pulls);
            for zone in &mut self.zones {
                zone.exchange(is_high, self.now_ms);
            }
        }
    }

    #[test]
    fn a_board_without_the_wire_shares_nothing() {
        let mut zone = SupplyShare::default();
        assert!(zone.claim());
        for now_ms in 0..10_000 {
            // A wire that floats is high now and then.
            assert!(!zone.exchange(now_ms % 60 > 3, now_ms));
            assert!(zone.claim() && !zone.is_shared());
        }
    }

    #[test]
    fn the_wire_is_pulled_by_the_zone_that_may_draw_power() {
        let mut wire = Wire::new();
        assert!(!wire.zones[0].claim(), "not before it has pulled");
        wire.step();
        assert!(wire.zones[0].claim());
        // Alone, it offers the wire once a second, and then the other one has it.
        let mut waited_ms = 0;
        while !wire.zones[1].claim() {
            assert!(wire.zones[0].holds());
            wire.step();
            waited_ms += 1;
        }
        assert!(waited_ms <= 1_010, "{waited_ms} ms");
        wire.step();
        assert!(!wire.zones[0].holds() && wire.zones.iter().all(SupplyShare::is_shared));
        // Shared, it keeps it until it lets go.
        for _ in 0..2_000 {
            assert!(!wire.zones[0].claim());
            wire.step();
        }
        wire.zones[1].release();
        (0..2).for_each(|_| wire.step());
        assert!(wire.zones[0].claim() && !wire.zones[1].holds());
    }

    /// Both read a free wire in the same millisecond and pull: neither sees the other, until one offers it.
    #[test]
    fn zones_that_pulled_at_once_part_within_seconds() {
        let mut wire = Wire::new();
        for zone in &mut wire.zones {
            zone.claim();
        }
        wire.step();
        assert!(wire.zones.iter().all(SupplyShare::holds));
        let mut both_ms = 0;
        for ms in 0..5_000_u32 {
            if ms.is_multiple_of(10) {
                // Powers of two coils with noise of their own.
                wire.zones[0].note(1_500_000 + ms.wrapping_mul(2_654_435_761) % 1_000);
                wire.zones[1].note(900_000 + ms.wrapping_mul(2_246_822_519) % 1_000);
            }
            wire.step();
            both_ms += u32::from(wire.zones.iter().all(SupplyShare::holds));
        }
        assert!(both_ms < 3_000, "{both_ms} ms");
        assert!(wire.zones.iter().any(SupplyShare::is_shared));
    }

    /// The wire is low for three quarters of the time, whatever the power of a burst: it falls by 5 % a period, to the least one.
    #[test]
    fn a_burst_has_less_power_while_the_wire_is_free_in_between() {
        let mut wire = Wire::new();
        wire.zones[0].claim();
        wire.step();
        for ms in 0..60_000_u32 {
            let zone = &mut wire.zones[0];
            let other_pulls = ms % 500 < 250;
            if (250..375).contains(&(ms % 500)) {
                zone.claim();
            } else {
                zone.release();
            }
            let is_high = !other_pulls && !zone.pulls;
            wire.now_ms = wire.now_ms.wrapping_add(1);
            zone.exchange(is_high, wire.now_ms);
            if ms == 5_500 {
                let fallen_w = f64::from(RATED_POWER_W) * 0.95_f64.powi(5);
                assert!((f64::from(zone.burst_w()) / fallen_w - 1.0).abs() < 0.06);
            }
        }
        assert_eq!(u32::from(wire.zones[0].burst_w()), BURST_POWER_W.into());
    }
}
