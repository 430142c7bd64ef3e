//! Sharing of a supply with a second zone, which has a controller of its own, over one wire.
//!
//! A zone pulls the wire low while it draws power, and draws power only while it pulls. So one zone at a time does: no beat of two
//! switching frequencies, and never more than one zone's power from the supply. While both are on, each gives its energy in
//! bursts of whole mains cycles ([`super::burst`]). The power of a burst is lowered until one burst follows the other, so that the
//! supply's current stays; it follows from the time for which the wire is low, which both zones see alike.
//!
//! Once the wire is found ([`super::share_wire`]) its end is pulled weakly down, and a zone
//! that pulls lets go for a millisecond in some ten: a wire that is low then is broken, or pulled by the other zone as well. So a wire
//! that breaks leaves the zone with the resistor alone, and the other without power.

use ihd_shared::hob::RATED_POWER_W;

use super::share_wire::{WireDrive, WireSearch, WireState};
use crate::limits::{BURST_PERIOD_MS, BURST_POWER_W, OFFER_MS, OTHER_ZONE_SILENT_MS};

/// Readings of a high wire in a row after which it is free: the check of a zone that pulls it is shorter.
const FREE_READINGS: u8 = 3;

/// Milliseconds of a pull before the first check, and least ones between two checks. Up to [`CHECK_NOISE`] more are added, so that two
/// zones that pull at once do not check at once.
const FIRST_CHECK_MS: u8 = 1;
const CHECK_MS: u8 = 8;
const CHECK_NOISE: u8 = 7;

/// Share of the time with a low wire above which it is always low: a handover takes some milliseconds.
const BUSY_PERCENT: u16 = 98;

/// Rise of a burst's power in a period when the wire is always low, and largest fall when it is not.
const RISE_PERCENT: u32 = 2;
const FALL_PERCENT: u32 = 5;

/// Time from a claim to the first offer, in milliseconds.
const FIRST_OFFER_MS: u16 = 500;

/// Claim on the supply.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Claim {
    None,
    /// Waiting for a free wire.
    Wanted,
    /// Pulled, and not yet checked: milliseconds until then.
    Pulled(u8),
    /// Milliseconds until the next check.
    Held(u8),
}

/// The wire, and the other zone behind it.
#[derive(Clone, Debug)]
pub struct SupplyShare {
    /// Time of the last reading.
    read_ms: u32,
    wire: WireSearch,
    claim: Claim,
    /// Readings of a high wire in a row, up to [`FREE_READINGS`].
    high: u8,
    /// Drive since the last reading; one that pulls low shows nothing else.
    drive: WireDrive,
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
            wire: WireSearch::default(),
            claim: Claim::None,
            high: 0,
            drive: WireDrive::default(),
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
    /// Takes the wire's level, every millisecond or more often; returns how this end is driven from now on.
    pub fn exchange(&mut self, is_high: bool, now_ms: u32) -> WireDrive {
        let elapsed_ms = now_ms.wrapping_sub(self.read_ms).min(100) as u16;
        if elapsed_ms == 0 && self.wire.state() != WireState::Unread {
            return self.drive;
        }
        self.read_ms = now_ms;
        self.drive = if self.wire.state() == WireState::Present {
            self.take_turns(is_high, elapsed_ms)
        } else {
            self.wire.seek(is_high, self.drive)
        };
        self.drive
    }

    fn take_turns(&mut self, is_high: bool, elapsed_ms: u16) -> WireDrive {
        let pulled = self.drive == WireDrive::Low;
        let other_pulls = !pulled && !is_high;
        self.silent_ms = if other_pulls {
            0
        } else {
            self.silent_ms.saturating_add(elapsed_ms)
        };
        self.high = if is_high && !pulled {
            FREE_READINGS.min(self.high + 1)
        } else {
            0
        };
        let elapsed = elapsed_ms as u8;
        let noise = self.noise & CHECK_NOISE;
        self.claim = match self.claim {
            // It has taken what was offered, or pulled in the same moment; or the wire is broken.
            Claim::Held(_) | Claim::Pulled(_) if other_pulls => Claim::None,
            Claim::Wanted if self.high >= FREE_READINGS => Claim::Pulled(FIRST_CHECK_MS + noise),
            Claim::Pulled(_) if !pulled => {
                // What it has just got it does not offer.
                self.offer_ms = self.counted_ms + FIRST_OFFER_MS;
                Claim::Held(CHECK_MS + noise)
            }
            Claim::Held(0) if !pulled => Claim::Held(CHECK_MS + noise),
            Claim::Pulled(left) => Claim::Pulled(left.saturating_sub(elapsed)),
            Claim::Held(left) if pulled => Claim::Held(left.saturating_sub(elapsed)),
            claim => claim,
        };
        // A check counts as low, as both zones see it.
        self.count(elapsed_ms, self.high < FREE_READINGS);
        // The other zone cannot say that it waits but by pulling a wire that is free.
        let offers = !self.is_shared()
            && (self.offer_ms..self.offer_ms + OFFER_MS).contains(&self.counted_ms);
        match self.claim {
            Claim::Held(1..) if !offers => WireDrive::Low,
            Claim::Pulled(1..) => WireDrive::Low,
            _ => WireDrive::WeaklyDown,
        }
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

    /// Takes the power of a half-cycle or a pot probe, in milliwatt, for its noise.
    pub fn note(&mut self, power_mw: u32) {
        self.noise = self.noise.rotate_left(3) ^ power_mw as u8;
    }

    /// Leaves the supply to the other zone, which then begins [`crate::limits::HANDOVER_HALF_CYCLES`] later.
    pub fn release(&mut self) {
        self.claim = Claim::None;
    }

    /// Returns `true` if this zone may draw power.
    pub fn holds(&self) -> bool {
        match self.wire.state() {
            WireState::Unread | WireState::Absent => true,
            WireState::Sought => false,
            WireState::Present => matches!(self.claim, Claim::Held(_)),
        }
    }

    /// Returns `true` while it is not known whether there is a wire, just after a start.
    pub fn is_sought(&self) -> bool {
        self.wire.state() == WireState::Sought
    }

    /// Returns `true` while the other zone is on.
    pub fn is_shared(&self) -> bool {
        self.silent_ms < OTHER_ZONE_SILENT_MS
    }

    /// Power of a burst while the supply is shared, in watt.
    pub fn burst_w(&self) -> u16 {
        self.burst_w
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two zones with the wire between them, stepped by milliseconds in which both read before either pulls.
    struct TwoZones {
        zones: [SupplyShare; 2],
        now_ms: u32,
    }

    impl TwoZones {
        /// Zones that know of the wire.
        fn new() -> Self {
            let mut both = Self {
                zones: [SupplyShare::default(), SupplyShare::default()],
                // The clock wraps on the way.
                now_ms: u32::MAX - 200,
            };
            both.run(100);
            both
        }

        fn step(&mut self) {
            self.now_ms = self.now_ms.wrapping_add(1);
            let is_high = self.zones.iter().all(|zone| zone.drive != WireDrive::Low);
            for zone in &mut self.zones {
                zone.exchange(is_high, self.now_ms);
            }
        }

        fn run(&mut self, ms: u32) {
            (0..ms).for_each(|_| self.step());
        }

        fn both_hold(&self) -> bool {
            self.zones.iter().all(SupplyShare::holds)
        }
    }

    /// A pin without a wire follows the chip's weak pull, but for what the bridge next to it couples into it.
    #[test]
    fn a_board_without_the_wire_shares_nothing() {
        let mut zone = SupplyShare::default();
        assert!(zone.claim(), "a board that reads no wire");
        let mut drive = WireDrive::WeaklyDown;
        for now_ms in 0..10_000 {
            let disturbed = now_ms > 1_000 && now_ms % 60 < 3;
            drive = zone.exchange((drive == WireDrive::WeaklyUp) != disturbed, now_ms);
            assert_ne!(drive, WireDrive::Low);
            assert!(!zone.is_shared());
            assert_eq!(zone.claim(), now_ms >= 20, "{now_ms} ms");
        }
    }

    /// It is reset, or switched on, whatever the other zone just does: neither its offers nor the gaps of its bursts mislead.
    #[test]
    fn a_zone_that_starts_while_the_other_heats_draws_nothing_beside_it() {
        for started_at_ms in 0..2_500 {
            let mut both = TwoZones::new();
            both.zones[1].claim();
            both.run(1_000 + started_at_ms);
            both.zones[0] = SupplyShare::default();
            both.step();
            for _ in 0..1_500 {
                both.zones[0].claim();
                both.step();
                assert!(!both.both_hold(), "started {started_at_ms} ms later");
            }
            // It takes what is offered.
            assert!(both.zones[0].holds());
        }
    }

    #[test]
    fn the_wire_is_pulled_by_the_zone_that_may_draw_power() {
        let mut both = TwoZones::new();
        assert!(!both.zones[0].claim(), "not before it has pulled");
        both.run(10);
        assert!(both.zones[0].claim());
        // Alone, it offers the wire once a second, and then the other one has it.
        let mut waited_ms = 0;
        while !both.zones[1].claim() {
            both.step();
            waited_ms += 1;
        }
        assert!(waited_ms <= 1_020, "{waited_ms} ms");
        assert!(!both.zones[0].holds() && both.zones.iter().all(SupplyShare::is_shared));
        // Shared, it keeps it until it lets go.
        for _ in 0..2_000 {
            assert!(!both.zones[0].claim());
            both.step();
        }
        both.zones[1].release();
        both.run(10);
        assert!(both.zones[0].claim() && !both.zones[1].holds());
    }

    /// Both read a free wire in the same millisecond and pull. The checks come at different times for seven of eight noises, and
    /// for the same ones as soon as the noises differ: here after 100 ms.
    #[test]
    fn zones_that_pull_at_once_part() {
        for noises in 0..64_u8 {
            let mut both = TwoZones::new();
            for (zone, noise) in both.zones.iter_mut().zip([noises % 8, noises / 8]) {
                zone.claim();
                zone.noise = noise;
            }
            let mut both_ms = 0;
            for ms in 0..5_000_u32 {
                if ms > 100 && ms.is_multiple_of(10) {
                    // Powers of two coils with noise of their own.
                    both.zones[0].note(1_500_000 + ms.wrapping_mul(2_654_435_761) % 1_000);
                    both.zones[1].note(900_000 + ms.wrapping_mul(2_246_822_519) % 1_000);
                }
                both.step();
                both_ms += u32::from(both.both_hold());
            }
            let most_ms = if noises % 8 == noises / 8 { 200 } else { 0 };
            assert!(both_ms <= most_ms, "{noises}: {both_ms} ms");
            assert!(both.zones.iter().any(SupplyShare::holds));
        }
    }

    /// The wire is low for three quarters of the time, whatever the power of a burst: it falls by 5 % a period, to the least one.
    #[test]
    fn a_burst_has_less_power_while_the_wire_is_free_in_between() {
        let mut both = TwoZones::new();
        both.zones[0].claim();
        both.run(10);
        for ms in 0..60_000_u32 {
            let zone = &mut both.zones[0];
            let other_pulls = ms % 500 < 250;
            if (250..375).contains(&(ms % 500)) {
                zone.claim();
            } else {
                zone.release();
            }
            let is_high = !other_pulls && zone.drive != WireDrive::Low;
            both.now_ms = both.now_ms.wrapping_add(1);
            zone.exchange(is_high, both.now_ms);
            if ms == 5_500 {
                let fallen_w = f64::from(RATED_POWER_W) * 0.95_f64.powi(5);
                assert!((f64::from(zone.burst_w()) / fallen_w - 1.0).abs() < 0.06);
            }
        }
        assert_eq!(u32::from(both.zones[0].burst_w()), BURST_POWER_W.into());
    }
}
