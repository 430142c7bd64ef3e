//! Requests of power: from the panel on the hob and from a host.
//!
//! - Off at the panel switches off, and stays: a host is refused until the panel requests power again.
//! - Off from the host, or for a reason of the hob's own, switches off whatever the panel shows; panel or host may switch on again.
//! - With both asking, the lower power counts. The panel's setting limits a host until somebody touches the panel again, off by the
//!   host or not: a host never heats more than the person chose.
//! - A host that is lost leaves no more power than it asked for, until somebody touches the panel or a host asks again.
//! - A panel that was never touched (a bare board has none) leaves everything to the host.
//! - The key lock keeps the panel from asking for more; off always works, locked or not.
//! - Switching on at the panel after switching off there is what a person does to end a lock-out.

use crate::limits::{HIGHEST_LEVEL, KEEP_WARM_LEVEL, LEVELS};
use crate::retained::control::PanelSetting;

/// Touch of the panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PanelEvent {
    /// Power level 0 (off) to [`HIGHEST_LEVEL`]; a higher one counts as that.
    Level(u8),
    /// Keeps warm what stands on the glass.
    KeepWarm,
    /// Locks the keys, or unlocks them.
    KeyLock(bool),
    /// Switches off after so many minutes; 0 takes it back. Nothing while nothing is on.
    Timer(u8),
}

/// Request of a host, in watt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum HostRequest {
    #[default]
    None,
    Power(u16),
    /// The last one of a host that is lost, which limits the panel's.
    Lost(u16),
}

/// The requests of panel and host.
#[derive(Clone, Copy, Debug, Default)]
pub struct PowerRequest {
    setting: PanelSetting,
    /// The setting requests power; else it only limits the host's.
    panel_requests: bool,
    key_locked: bool,
    host: HostRequest,
}

/// Result of a touch of the panel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PanelResult {
    /// The keys are locked, or nothing changed.
    Nothing,
    /// Another power, or the lock.
    Changed,
    /// On, after off at the panel: a person is there.
    SwitchedOn,
    /// Off after so many minutes; 0 takes it back.
    Timer(u8),
}

impl PowerRequest {
    /// The requests after a reset: none, and the panel's setting limits a host as before.
    pub fn restored(setting: PanelSetting, key_locked: bool) -> Self {
        Self {
            setting,
            key_locked,
            ..Self::default()
        }
    }

    /// Takes a touch of the panel.
    pub fn panel(&mut self, event: PanelEvent) -> PanelResult {
        match event {
            PanelEvent::KeyLock(locked) => {
                self.key_locked = locked;
                PanelResult::Changed
            }
            PanelEvent::Level(0) => {
                self.switch_off_at_panel();
                PanelResult::Changed
            }
            PanelEvent::Level(_) | PanelEvent::KeepWarm | PanelEvent::Timer(_)
                if self.key_locked =>
            {
                PanelResult::Nothing
            }
            PanelEvent::Timer(_) if self.power_w() == 0 => PanelResult::Nothing,
            PanelEvent::Timer(minutes) => PanelResult::Timer(minutes),
            PanelEvent::Level(level) => self.set(PanelSetting::Level(level.min(HIGHEST_LEVEL))),
            PanelEvent::KeepWarm => self.set(PanelSetting::KeepWarm),
        }
    }

    fn set(&mut self, setting: PanelSetting) -> PanelResult {
        self.panel_requests = true;
        if let HostRequest::Lost(_) = self.host {
            self.host = HostRequest::None;
        }
        match core::mem::replace(&mut self.setting, setting) {
            PanelSetting::OFF => PanelResult::SwitchedOn,
            _ => PanelResult::Changed,
        }
    }

    /// Takes the host's request, in watt; returns `false` if the panel is off.
    pub fn host(&mut self, power_w: u16) -> bool {
        if power_w == 0 {
            self.switch_off();
            return true;
        }
        if self.setting == PanelSetting::OFF {
            return false;
        }
        self.host = HostRequest::Power(power_w);
        true
    }

    /// Ends the host's request: the host is silent, or another one sends its hello. The panel's stays, with no more power than before.
    pub fn host_lost(&mut self) {
        self.host = match self.host {
            HostRequest::Power(power_w) if self.panel_requests => HostRequest::Lost(power_w),
            HostRequest::Power(_) => HostRequest::None,
            host => host,
        };
    }

    /// Returns `true` if the host requests power.
    pub fn is_of_host(&self) -> bool {
        matches!(self.host, HostRequest::Power(_))
    }

    /// Switches off for a reason of the hob's own; panel or host may request power again.
    pub fn switch_off(&mut self) {
        self.host = HostRequest::None;
        self.panel_requests = false;
    }

    /// Switches off until somebody touches the panel: a host is refused.
    pub fn switch_off_at_panel(&mut self) {
        self.setting = PanelSetting::OFF;
        self.switch_off();
    }

    /// Returns `true` if the panel is off and refuses the host.
    pub fn is_off_at_panel(&self) -> bool {
        self.setting == PanelSetting::OFF
    }

    /// Takes the panel's highest level one lower.
    pub fn end_boost(&mut self) {
        if let PanelSetting::Level(level) = &mut self.setting {
            *level = (HIGHEST_LEVEL - 1).min(*level);
        }
    }

    /// The panel's setting, in force or not, as it outlives a reset.
    pub fn setting(&self) -> PanelSetting {
        self.setting
    }

    /// Requested power, in watt.
    pub fn power_w(&self) -> u16 {
        let panel_w = level_of(self.setting).map_or(u16::MAX, level_power_w);
        match self.host {
            HostRequest::Power(host_w) => panel_w.min(host_w),
            HostRequest::Lost(host_w) if self.panel_requests => panel_w.min(host_w),
            HostRequest::None if self.panel_requests => panel_w,
            HostRequest::Lost(_) | HostRequest::None => 0,
        }
    }

    /// Returns `true` if the panel holds the power below the host's request.
    pub fn is_held_by_panel(&self) -> bool {
        matches!(self.host, HostRequest::Power(host_w) if self.power_w() < host_w)
    }

    /// The panel's level, [`KEEP_WARM_LEVEL`] for keeping warm; `None` until it is touched, and while its setting neither requests
    /// power nor limits a host's.
    pub fn level(&self) -> Option<u8> {
        level_of(self.setting).filter(|_| self.is_setting_in_force())
    }

    /// Returns `true` if what stands on the glass is to be kept warm.
    pub fn keeps_warm(&self) -> bool {
        self.setting == PanelSetting::KeepWarm && self.is_setting_in_force()
    }

    fn is_setting_in_force(&self) -> bool {
        self.panel_requests || self.is_of_host() || self.is_off_at_panel()
    }

    /// Returns `true` if the keys are locked.
    pub fn is_key_locked(&self) -> bool {
        self.key_locked
    }
}

/// Level of power of a setting; `None` while the panel is untouched.
fn level_of(setting: PanelSetting) -> Option<u8> {
    match setting {
        PanelSetting::Untouched => None,
        PanelSetting::Level(level) => Some(level),
        PanelSetting::KeepWarm => Some(KEEP_WARM_LEVEL),
    }
}

/// Power of a panel's level, in watt; 0 for level 0.
fn level_power_w(level: u8) -> u16 {
    let place = usize::from(level).checked_sub(1);
    let level = place.and_then(|place| LEVELS.get(place));
    level.map_or(0, |level| level.power_w)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hob_heats_without_any_host() {
        let mut request = PowerRequest::default();
        assert_eq!(request.power_w(), 0);
        request.panel(PanelEvent::Level(7));
        assert_eq!(request.power_w(), 1_400);
        request.host_lost();
        assert_eq!(request.power_w(), 1_400);
    }

    #[test]
    fn off_at_the_panel_wins_over_the_host_until_it_is_on_again() {
        let mut request = PowerRequest::default();
        assert!(request.host(2_000));
        request.panel(PanelEvent::Level(0));
        assert_eq!(request.power_w(), 0);
        assert!(!request.host(2_000));
        assert_eq!(request.power_w(), 0);
        assert_eq!(request.panel(PanelEvent::Level(9)), PanelResult::SwitchedOn);
        assert!(request.host(2_000));
        assert_eq!(request.power_w(), 2_000);
    }

    #[test]
    fn the_lower_of_both_counts_and_off_from_the_host_stays_off() {
        let mut request = PowerRequest::default();
        request.panel(PanelEvent::Level(5));
        assert!(request.host(2_000));
        assert_eq!(request.power_w(), 700);
        assert!(request.is_held_by_panel());
        assert!(request.host(300));
        assert_eq!(request.power_w(), 300);
        assert!(request.host(0));
        assert_eq!(request.power_w(), 0);
        request.host_lost();
        assert_eq!(request.power_w(), 0, "the panel's level must not come back");
    }

    /// A daemon that takes a hob from another host switches it off first; a pot that is gone for long switches off as well.
    #[test]
    fn a_host_never_heats_more_than_the_person_chose_whatever_switched_off_before() {
        for (touch, most_w, keeps_warm) in [
            (PanelEvent::Level(1), 100, false),
            (PanelEvent::KeepWarm, 350, true),
        ] {
            let off: [fn(&mut PowerRequest); 4] = [
                |request| assert!(request.host(0)),
                PowerRequest::switch_off,
                |request| {
                    request.host_lost();
                    request.switch_off();
                },
                PowerRequest::host_lost,
            ];
            for switch_off in off {
                let mut request = PowerRequest::default();
                request.panel(touch);
                assert!(request.host(2_500));
                switch_off(&mut request);
                assert!(request.host(2_500));
                assert_eq!(request.power_w(), most_w, "{touch:?}");
                assert!(request.is_held_by_panel());
                assert_eq!(request.keeps_warm(), keeps_warm);
                assert!(request.host(0));
                assert_eq!((request.power_w(), request.level()), (0, None));
                assert_eq!(
                    request.panel(PanelEvent::Level(9)),
                    PanelResult::Changed,
                    "it was not off at the panel"
                );
                assert!(request.host(2_500));
                assert_eq!(request.power_w(), 2_500);
            }
        }
    }

    #[test]
    fn the_end_of_a_link_raises_no_power() {
        let mut request = PowerRequest::default();
        request.panel(PanelEvent::Level(9));
        assert!(request.host(100));
        request.host_lost();
        request.host_lost();
        assert_eq!(request.power_w(), 100);
        assert_eq!(request.level(), Some(9));
        assert!(request.host(300));
        assert_eq!(request.power_w(), 300);
        request.host_lost();
        request.panel(PanelEvent::Level(8));
        assert_eq!(request.power_w(), 1_900);
    }

    #[test]
    fn locked_keys_only_switch_off() {
        let mut request = PowerRequest::default();
        request.panel(PanelEvent::Level(3));
        request.panel(PanelEvent::KeyLock(true));
        assert_eq!(request.panel(PanelEvent::Level(9)), PanelResult::Nothing);
        assert_eq!(request.power_w(), 350);
        request.panel(PanelEvent::Level(0));
        assert_eq!(request.power_w(), 0);
        assert_eq!(request.panel(PanelEvent::Level(9)), PanelResult::Nothing);
        request.panel(PanelEvent::KeyLock(false));
        assert_eq!(request.panel(PanelEvent::Level(1)), PanelResult::SwitchedOn);
        assert_eq!(request.power_w(), 100);
    }
}
