//! Continuous learning from a heating hob until the run is stopped. A state in which the hob does not heat is reported and does not end
//! the run; a cut link is made again.

use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_link::{DeviceEvent, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{OffReason, State, Telemetry};

use super::run::Run;
use super::{OperatingPoint, RunProgress, TrainerError};

/// Longest time for reconnecting a cut link.
const RECONNECT_WITHIN: Duration = Duration::from_secs(60);

/// Pause between two attempts to reconnect.
const RECONNECT_EVERY: Duration = Duration::from_secs(1);

impl Run<'_, '_> {
    /// Learns from every window until the run is stopped.
    pub(super) fn follow(&mut self, asked_w: u16) -> Result<(), TrainerError> {
        let last = self.report.last.as_ref();
        let mut since = last.map_or(0, |(window, _, _)| window.half_cycle);
        loop {
            let learned = match self.next_followed(since, asked_w) {
                Ok(Some(window)) => {
                    since = window.half_cycle;
                    self.learn_followed(window, asked_w)
                }
                Ok(None) => Ok(()),
                Err(why) => Err(why),
            };
            match learned {
                Ok(()) => {}
                Err(TrainerError::Interrupted) => return Ok(()),
                Err(why) if self.settings.reopen.is_some() && is_cut(&why) => {
                    if self.reconnect(&why, asked_w)? == Boot::Another {
                        since = 0;
                    }
                }
                Err(why) => return Err(why),
            }
        }
    }

    fn next_followed(
        &mut self,
        since: u32,
        asked_w: u16,
    ) -> Result<Option<Box<Window>>, TrainerError> {
        match self.device.next_event("telemetry")? {
            Some(DeviceEvent::Window(window)) if window.half_cycle > since => {
                return Ok(Some(window));
            }
            Some(DeviceEvent::Telemetry(t)) => self.report_state_change(t, asked_w),
            Some(DeviceEvent::WindowRejected { seq, reason }) => {
                let why = &reason.to_string();
                self.device.report(RunProgress::Rejected { seq, why });
            }
            // Telemetry shows the effect of a fault.
            Some(DeviceEvent::Window(_) | DeviceEvent::Fault(_) | DeviceEvent::Log { .. })
            | None => {}
        }
        Ok(None)
    }

    /// Learns from a window; a refused window or lookup is reported and does not end the run.
    fn learn_followed(&mut self, window: Box<Window>, asked_w: u16) -> Result<(), TrainerError> {
        let at = OperatingPoint::Heating { asked_w };
        match self.learn(window, at, None, false) {
            Ok(_) => Ok(()),
            Err(TrainerError::Lookup(text)) => {
                self.device.report(RunProgress::Note { text: &text });
                Ok(())
            }
            Err(why) => Err(why),
        }
    }

    /// Reports a change of state or fault since the half-cycle before, in a line.
    fn report_state_change(&mut self, t: Telemetry, asked_w: u16) {
        let before = self.device.last.replace(t.clone());
        self.device.is_switched_off = t.state == State::Idle;
        let same = |b: &Telemetry| b.state == t.state && b.fault == t.fault;
        if before.as_ref().is_some_and(same) {
            return;
        }
        let text = match t.state {
            State::WaitingForPot | State::Pausing => {
                let telemetry = &t;
                return self.device.report(RunProgress::Waiting { asked_w, telemetry });
            }
            State::LockedOut => format!("{}: off until a person switches it off and on", t.fault),
            State::Idle if t.fault != Fault::NONE => format!("off: {}", t.fault),
            State::Idle => "off: at its panel, by another host, or no pot came; it is not switched on again, and \
                 learned from when somebody heats with it"
                .into(),
            State::Heating if before.is_some_and(|b| b.state != State::Probing) => {
                format!("heats with {} W", t.asked_w)
            }
            State::Heating | State::Probing => return,
        };
        self.device.report(RunProgress::Note { text: &text });
    }

    /// Reconnects; gives up after [`RECONNECT_WITHIN`].
    fn reconnect(&mut self, why: &TrainerError, asked_w: u16) -> Result<Boot, TrainerError> {
        let before = BootMark {
            boot_id: self.boot_id,
            half_cycle: self.device.last.as_ref().map_or(0, |t| t.half_cycle),
        };
        let until = Instant::now() + RECONNECT_WITHIN;
        let seconds = RECONNECT_WITHIN.as_secs();
        self.device.report(RunProgress::Note {
            text: &format!("{why}; trying again for {seconds} s"),
        });
        loop {
            self.device.detach();
            self.open_again(until)?;
            match self.resume(&before, asked_w) {
                Err(why) if is_cut(&why) && Instant::now() < until => {}
                resumed => return resumed,
            }
        }
    }

    fn resume(&mut self, before: &BootMark, asked_w: u16) -> Result<Boot, TrainerError> {
        let status = self.device.command(|client| client.status())?;
        self.learning.set_device_version(status.lookup_version);
        self.device.stream()?;
        let mut boot = Boot::Same;
        let is_younger = status.half_cycles < before.half_cycle;
        let text = if self.boot_id != before.boot_id || is_younger {
            boot = Boot::Another;
            // A person has restarted it, or it has reset itself for a reason.
            "connected again; it has started anew and is not switched on again".into()
        } else if status.state == State::LockedOut || status.asked_w == asked_w {
            "connected again".into()
        } else if !ended_by_silence(status.off_reason, self.device.is_switched_off) {
            "connected again; it was switched off, or gave up, and is not switched on again".into()
        } else {
            match self.device.request_power(asked_w) {
                Ok(asked_w) => format!("connected again, {asked_w} W asked for again"),
                Err(TrainerError::Link(why @ LinkError::Refused { .. })) => {
                    format!("connected again; {why}")
                }
                Err(why) => return Err(why),
            }
        };
        self.device.report(RunProgress::Note { text: &text });
        Ok(boot)
    }

    fn open_again(&mut self, until: Instant) -> Result<(), TrainerError> {
        loop {
            let Some(reopen) = self.settings.reopen else {
                return Ok(());
            };
            match reopen() {
                Ok(client) => {
                    self.connected(client);
                    return Ok(());
                }
                Err(why) if Instant::now() >= until => return Err(why.into()),
                Err(_) => {}
            }
            let next = Instant::now() + RECONNECT_EVERY;
            while Instant::now() < next {
                if self.device.is_stopped() {
                    return Err(TrainerError::Interrupted);
                }
                sleep(Duration::from_millis(50));
            }
        }
    }
}

/// Returns `true` if nothing but the silence of the host has ended the power: the device was not idle when it was last seen, and
/// states no reason of its own since.
fn ended_by_silence(reason: OffReason, was_switched_off: bool) -> bool {
    !was_switched_off && reason == OffReason::None
}

/// Mark of a boot. The half-cycle is needed too: a simulated hob has the same boot number every time.
struct BootMark {
    boot_id: u32,
    half_cycle: u32,
}

/// Boot of a device after a reconnection: the same, or another one.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Boot {
    Same,
    Another,
}

/// Returns `true` if a new link may help.
fn is_cut(why: &TrainerError) -> bool {
    match why {
        TrainerError::Silent { .. } => true,
        TrainerError::Link(why) => why.may_pass(),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pot that comes back while the link is away heats no more.
    #[test]
    fn power_is_asked_for_again_only_where_silence_has_ended_it() {
        assert!(ended_by_silence(OffReason::None, false));
        assert!(!ended_by_silence(OffReason::None, true));
        assert!(!ended_by_silence(OffReason::NoPot, false));
    }
}
