//! Events of a file in order of time, with the restorations.

use std::path::Path;

use ihd_firmware::control::request::PanelEvent;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::grid::{self, CURRENTS, FREQUENCIES};
use ihd_shared::lookup::prior::prior;
use ihd_shared::lookup::{HENRY_PER_CODE, OHM_PER_CODE, RlLookup};

use super::ScenarioError;
use super::file::{EventField, HostWord, MainsField, Scenario};
use super::summary::Kind;
use crate::injection::Injection;
use crate::pot::SimulatedPot;
use crate::recording::prepared::surrogate_pot;
use ihd_shared::hob::WINDING_R_OHM;

/// Change.
#[derive(Clone, Debug)]
pub enum TimelineChange {
    /// Power requested by the host, in watt.
    Power(u16),
    /// New pot.
    Pot(SimulatedPot),
    /// Pot as before the event of this number.
    PotBack(usize),
    /// New voltage or frequency.
    Mains(MainsField),
    /// Mains as before the event of this number.
    MainsBack(usize),
    /// Start of a fault.
    Inject(Injection),
    /// End of the fault of the event of this number.
    InjectEnd(usize),
    /// User's action on the panel.
    Panel(PanelEvent),
    /// Minutes pass for the times of cooking.
    Pass(u16),
    /// Ambient temperature in °C.
    Ambient(f64),
    /// The heat sink's temperature in °C.
    HeatSink(f64),
    /// The glass's temperature in °C.
    Glass(f64),
    /// The host stops sending.
    Silent,
    /// The host clears the fault.
    ClearFault,
    /// The host restores the built-in lookup.
    ResetLookup,
    /// The host pushes a lookup.
    PushLookup(Box<RlLookup>),
    /// The host repeats a request until a time in seconds.
    Repeat {
        /// Request.
        what: RepeatedRequest,
        /// Period in seconds.
        every_s: f64,
        /// End in seconds.
        until_s: f64,
    },
}

impl TimelineChange {
    /// Returns `true` for a change made by the host.
    pub fn is_of_host(&self) -> bool {
        matches!(
            self,
            Self::Power(_)
                | Self::Silent
                | Self::ClearFault
                | Self::ResetLookup
                | Self::PushLookup(_)
                | Self::Repeat { .. }
        )
    }

    /// Kind with respect to the power; a panel's level sets a power too, which its hob knows.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Power(power_w)
            | Self::Repeat {
                what: RepeatedRequest::Power(power_w, false),
                ..
            } => Kind::Power(*power_w),
            Self::Pot(_) | Self::PotBack(_) | Self::Mains(_) | Self::MainsBack(_) => {
                Kind::Disturbed
            }
            _ => Kind::Other,
        }
    }
}

/// Repeated request of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RepeatedRequest {
    /// Power in watt; `true` to alternate with 0.
    Power(u16, bool),
    /// Clears the fault.
    ClearFault,
}

/// Change with its time.
#[derive(Clone, Debug)]
pub struct TimedChange {
    /// Time in seconds.
    pub at_s: f64,
    /// Number of its event in the file, from 0.
    pub event: usize,
    /// Change.
    pub change: TimelineChange,
}

/// Returns all changes in order of time and, at the same time, of the file.
///
/// # Errors
/// [`ScenarioError::Event`] for inconsistent fields.
pub fn timeline(scenario: &Scenario) -> Result<Vec<TimedChange>, ScenarioError> {
    let mut all = Vec::new();
    let mut versions = 0;
    for (event, field) in scenario.file.event.iter().enumerate() {
        let field = field.get_ref();
        let wrong = |why: String| ScenarioError::Event {
            number: event + 1,
            line: scenario.lines[event],
            why,
        };
        let touches = field.panel.is_some()
            || field.keep_warm.is_some()
            || field.key_lock.is_some()
            || field.timer_min.is_some();
        if touches && !scenario.file.panel {
            return Err(wrong("there is no panel: panel = false".to_owned()));
        }
        let mut changes = Changes {
            event,
            field,
            all: &mut all,
        };
        let before = changes.all.len();
        changes.of_plant().map_err(wrong)?;
        changes
            .of_host(&scenario.directory, &mut versions)
            .map_err(wrong)?;
        if all.len() == before {
            return Err(wrong(
                "nothing happens: give power_w, pot, mains, inject, host, panel, keep_warm, key_lock, timer_min, \
                 pass_min, ambient_c, heat_sink_c or glass_c".to_owned(),
            ));
        }
    }
    all.sort_by(|a, b| a.at_s.total_cmp(&b.at_s).then(a.event.cmp(&b.event)));
    Ok(all)
}

/// Changes of one event.
struct Changes<'a> {
    event: usize,
    field: &'a EventField,
    all: &'a mut Vec<TimedChange>,
}

impl Changes<'_> {
    fn push(&mut self, at_s: f64, change: TimelineChange) {
        self.all.push(TimedChange {
            at_s,
            event: self.event,
            change,
        });
    }

    fn of_plant(&mut self) -> Result<(), String> {
        let (event, field) = (self.event, self.field);
        let end_s = |own: Option<f64>| own.or(field.for_s).map(|for_s| field.at_s + for_s);
        if let Some(pot) = field.pot {
            pot.pot
                .field_settings(0.0)
                .map_err(|e| format!("pot {}: {e}", pot.pot))?;
            self.push(field.at_s, TimelineChange::Pot(pot.pot));
            if let Some(end_s) = end_s(pot.for_s) {
                self.push(end_s, TimelineChange::PotBack(event));
            }
        }
        if let Some(mains) = field.mains {
            if mains.v_rms.is_none() && mains.hz.is_none() && mains.open.is_none() {
                return Err("mains: give v_rms, hz or open".to_owned());
            }
            self.push(field.at_s, TimelineChange::Mains(mains));
            if let Some(end_s) = end_s(mains.for_s) {
                self.push(end_s, TimelineChange::MainsBack(event));
            }
        }
        self.of_person_and_heat();
        let Some(kind) = field.inject else {
            return match (field.value, field.channel) {
                (None, None) => Ok(()),
                _ => Err("value and channel belong to inject".to_owned()),
            };
        };
        let value = match (kind.range(), field.value) {
            (None, None) => 0.0,
            (None, Some(_)) => return Err(format!("{kind} takes no value")),
            (Some((min, max, _)), Some(v)) if (min..=max).contains(&v) => v,
            (Some((_, _, allowed)), _) => return Err(format!("{kind} needs value = {allowed}")),
        };
        let channel = field.channel.unwrap_or(kind.default_channel());
        self.push(
            field.at_s,
            TimelineChange::Inject(Injection {
                kind,
                value,
                channel,
            }),
        );
        if let Some(end_s) = end_s(None) {
            self.push(end_s, TimelineChange::InjectEnd(event));
        }
        Ok(())
    }

    fn of_person_and_heat(&mut self) {
        let field = self.field;
        let level = field.panel.map(|level| PanelEvent::Level(level as u8));
        let warm = (field.keep_warm == Some(true)).then_some(PanelEvent::KeepWarm);
        let key_lock = field.key_lock.map(PanelEvent::KeyLock);
        let timer = field.timer_min.map(|min| PanelEvent::Timer(min as u8));
        let changes = [
            level.map(TimelineChange::Panel),
            warm.map(TimelineChange::Panel),
            key_lock.map(TimelineChange::Panel),
            timer.map(TimelineChange::Panel),
            field
                .pass_min
                .map(|minutes| TimelineChange::Pass(minutes as u16)),
            field.ambient_c.map(TimelineChange::Ambient),
            field.heat_sink_c.map(TimelineChange::HeatSink),
            field.glass_c.map(TimelineChange::Glass),
        ];
        for change in changes.into_iter().flatten() {
            self.push(field.at_s, change);
        }
    }

    fn of_host(&mut self, directory: &Path, versions: &mut u32) -> Result<(), String> {
        let field = self.field;
        let power_w = field.power_w.map(|w| w.round() as u16);
        let until_s = field.at_s + field.for_s.unwrap_or(f64::INFINITY);
        let every_s = || {
            let given = field.every_s.filter(|s| *s >= 1e-3);
            given.ok_or("give every_s = 0.001 s or more".to_owned())
        };
        let change = match field.host {
            None => match power_w {
                Some(power_w) => TimelineChange::Power(power_w),
                None => return Ok(()),
            },
            Some(HostWord::Silent) => TimelineChange::Silent,
            Some(HostWord::ClearFault) => TimelineChange::ClearFault,
            Some(HostWord::ResetLookup) => TimelineChange::ResetLookup,
            Some(HostWord::ClearFaultEvery) => TimelineChange::Repeat {
                what: RepeatedRequest::ClearFault,
                every_s: every_s()?,
                until_s,
            },
            Some(HostWord::SetPowerEvery) => {
                let power_w = power_w.ok_or(format!("give power_w = 0 to {RATED_POWER_W}"))?;
                TimelineChange::Repeat {
                    what: RepeatedRequest::Power(power_w, field.toggle),
                    every_s: every_s()?,
                    until_s,
                }
            }
            Some(HostWord::PushLookup) => {
                *versions += 1;
                TimelineChange::PushLookup(Box::new(lookup(field, directory, *versions)?))
            }
        };
        self.push(field.at_s, change);
        Ok(())
    }
}

/// Lookup of an event; a constant one counts as observed everywhere.
fn lookup(field: &EventField, directory: &Path, version: u32) -> Result<RlLookup, String> {
    let code = |value: f64, unit: f64| (value / unit).round().clamp(0.0, 65_535.0) as u16;
    let mut lookup = prior();
    lookup.observed = lookup.observed.map(|_| 0xFF);
    match (&field.file, field.of_pot, field.r_ohm, field.l_uh) {
        (Some(file), None, None, None) => {
            let path = directory.join(file);
            let bytes = std::fs::read(&path)
                .map_err(|e| format!("cannot read lookup {}: {e}", path.display()))?;
            lookup = RlLookup::from_bytes(&bytes)
                .map_err(|e| format!("lookup {}: {e}", path.display()))?;
        }
        (None, Some(pot), None, None) => {
            let wrong = |e| format!("of_pot {pot}: {e}");
            let table = surrogate_pot(&pot, WINDING_R_OHM).map_err(wrong)?;
            for f in 0..FREQUENCIES {
                let load = table.at(grid::frequency_hz(f));
                for i in 0..CURRENTS {
                    let (r_ohm, l_h) = load.r_l(grid::current_a(i));
                    lookup.r[f][i] = code(r_ohm, OHM_PER_CODE);
                    lookup.l[f][i] = code(l_h, HENRY_PER_CODE);
                }
            }
        }
        (None, None, Some(r_ohm), Some(l_uh)) => {
            let (r, l) = (code(r_ohm, OHM_PER_CODE), code(l_uh * 1e-6, HENRY_PER_CODE));
            (lookup.r, lookup.l) = (
                lookup.r.map(|row| row.map(|_| r)),
                lookup.l.map(|row| row.map(|_| l)),
            );
        }
        _ => {
            return Err("push-lookup: give file, of_pot, or both r_ohm and l_uh".to_owned());
        }
    };
    if let Some(version) = field.version.or(field.file.is_none().then_some(version)) {
        lookup.version = version;
    }
    Ok(lookup)
}
