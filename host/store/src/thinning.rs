//! Thinning: choice of the windows whose samples are deleted when room is needed. The newest stay; of older ones fewer do.
//!
//! 1. Windows older than an hour that show no change of R or L beyond their standard deviation.
//! 2. Of the rest, those beyond one a minute.
//! 3. The oldest days, whole.
//! 4. The oldest windows of the last hour.
//!
//! Nothing is deleted while there is room, at any age. Rows and results stay.

use std::collections::BTreeMap;

/// A step of thinning. Each goes through all windows, oldest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Tier {
    /// Keeps one window per change of R or L.
    Changes,
    /// Keeps one a minute.
    Minutes,
    /// Keeps none.
    Nothing,
}

/// A window with samples.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub(crate) id: i64,
    pub(crate) device: String,
    pub(crate) boot: u32,
    pub(crate) seq: u32,
    pub(crate) at_ms: i64,
    /// `true` if it is to be sent to a fleet, or waits for its answer.
    pub(crate) is_unanswered: bool,
}

/// R and L of a window, with their standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ImpedanceEstimate {
    pub(crate) r_ohm: f64,
    pub(crate) l_h: f64,
    pub(crate) sigma_r_pct: f64,
    pub(crate) sigma_l_pct: f64,
}

impl ImpedanceEstimate {
    /// Returns `true` if R or L differs from that of another window by more than a standard deviation of this one.
    fn differs(&self, last: &Self) -> bool {
        // Without a standard deviation every difference counts.
        let beyond = |x: f64, last: f64, sigma_pct: f64| {
            (x - last).abs()
                > x.abs()
                    * 1e-2
                    * if sigma_pct.is_finite() {
                        sigma_pct
                    } else {
                        0.0
                    }
        };
        beyond(self.r_ohm, last.r_ohm, self.sigma_r_pct)
            || beyond(self.l_h, last.l_h, self.sigma_l_pct)
    }
}

/// Progress of a tier, with the last stored window of each device.
#[derive(Debug)]
pub(crate) struct Cursor {
    pub(crate) tier: Tier,
    /// Day of the current file; empty before the first.
    pub(crate) day: String,
    /// Last row passed there.
    pub(crate) after: i64,
    last: BTreeMap<String, LastStored>,
}

#[derive(Debug)]
struct LastStored {
    identified: Option<ImpedanceEstimate>,
    minute: i64,
}

impl Cursor {
    pub(crate) fn new(tier: Tier) -> Self {
        Self {
            tier,
            day: String::new(),
            after: 0,
            last: BTreeMap::new(),
        }
    }

    /// Moves to the beginning of a day.
    pub(crate) fn turn_to(&mut self, day: &str) {
        self.day = day.to_owned();
        self.after = 0;
    }

    /// Passes a window; returns `true` if its samples stay.
    pub(crate) fn pass(
        &mut self,
        window: &Candidate,
        identified: Option<ImpedanceEstimate>,
    ) -> bool {
        self.after = window.id;
        let minute = window.at_ms.div_euclid(60_000);
        let before = self.last.get(&window.device);
        let keeps = match self.tier {
            Tier::Changes => match (identified, before.and_then(|last| last.identified)) {
                (Some(now), Some(before)) => now.differs(&before),
                // The answer needs the samples.
                (now, _) => now.is_some() || window.is_unanswered,
            },
            Tier::Minutes => before.is_none_or(|last| last.minute != minute),
            Tier::Nothing => false,
        };
        if keeps {
            let last = LastStored { identified, minute };
            self.last.insert(window.device.clone(), last);
        }
        keeps
    }
}

/// Cursors of the tiers that go through all days.
#[derive(Debug)]
pub(crate) struct Thinning {
    pub(crate) changes: Cursor,
    pub(crate) minutes: Cursor,
}

impl Default for Thinning {
    fn default() -> Self {
        Self {
            changes: Cursor::new(Tier::Changes),
            minutes: Cursor::new(Tier::Minutes),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn window(id: i64, device: &str) -> Candidate {
        Candidate {
            id,
            device: device.to_owned(),
            boot: 1,
            seq: id as u32,
            at_ms: id * 20_000,
            is_unanswered: false,
        }
    }

    fn identified(r_ohm: f64, l_h: f64) -> Option<ImpedanceEstimate> {
        Some(ImpedanceEstimate {
            r_ohm,
            l_h,
            sigma_r_pct: 1.0,
            sigma_l_pct: 0.5,
        })
    }

    #[test]
    fn one_window_per_change_of_r_or_l_beyond_its_deviation() {
        let mut cursor = Cursor::new(Tier::Changes);
        let l = 80e-6;
        let mut keeps = |id, device, what| cursor.pass(&window(id, device), what);
        assert!(!keeps(1, "a", None), "nobody identified it");
        assert!(keeps(2, "a", identified(2.00, l)));
        assert!(!keeps(3, "a", identified(2.019, l)));
        assert!(keeps(4, "b", identified(2.019, l)), "another device");
        // A slow drift is a change against what was kept, not against the neighbour.
        assert!(keeps(5, "a", identified(2.025, l)));
        assert!(!keeps(6, "a", identified(2.03, l * 1.004)));
        assert!(keeps(7, "a", identified(2.03, l * 1.006)));
        assert!(!keeps(8, "a", None));
        let without = ImpedanceEstimate {
            sigma_r_pct: f64::NAN,
            ..identified(2.031, l * 1.006).unwrap()
        };
        assert!(keeps(9, "a", Some(without)));
        let unanswered = Candidate {
            is_unanswered: true,
            ..window(10, "a")
        };
        assert!(cursor.pass(&unanswered, None), "its answer needs it");
        assert_eq!(cursor.after, 10);
    }

    #[test]
    fn one_window_a_minute_of_each_device() {
        let mut cursor = Cursor::new(Tier::Minutes);
        // A window each 20 s of two devices: rows 0, 3, 6 begin a minute.
        for id in 0..9 {
            assert_eq!(cursor.pass(&window(id, "a"), None), id % 3 == 0, "{id}");
            assert_eq!(cursor.pass(&window(id, "b"), None), id % 3 == 0, "{id}");
        }
    }
}
