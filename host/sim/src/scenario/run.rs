//! Run of a scenario, block by block.

use ihd_firmware::control::request::PanelEvent;
use ihd_firmware::limits::KEEP_WARM_LEVEL;
use ihd_shared::wire::messages::{Configure, State};

use super::ScenarioError;
use super::fault_log::FaultLog;
use super::file::Scenario;
use super::host::Host;
use super::record::{Record, TrueHalfCycle};
use super::summary::{self, Kind, Mark};
use super::surroundings::{ChangeableHob, Surroundings};
use super::timeline::{TimedChange, TimelineChange, timeline};
use crate::hob::SimHob;
use crate::thermal_model::ThermalModel;

/// Runs a scenario; `progress` is called with the share done, 0 to 1, once a half-cycle.
///
/// # Errors
/// [`ScenarioError`] for invalid events and settings, before anything runs.
pub fn run(scenario: &Scenario, mut progress: impl FnMut(f64)) -> Result<Record, ScenarioError> {
    let events = timeline(scenario)?;
    let mut run = Run::new(scenario)?;
    Surroundings::prepare(run.hob.plant(), &events)?;
    let duration_s = scenario.file.duration_s;
    let mut next = events.iter().peekable();
    while run.hob.t_s() < duration_s {
        while let Some(timed) = next.next_if(|e| e.at_s <= run.hob.t_s()) {
            run.apply(timed)?;
        }
        run.hob.step();
        run.host.turn(&mut run.hob);
        let fault = run.hob.sampling_path().fault();
        run.faults
            .watch(fault, run.hob.t_s(), run.hob.open_since_s());
        if run.take_half_cycle() {
            progress((run.hob.t_s() / duration_s).min(1.0));
        }
    }
    progress(1.0);
    Ok(run.finish(duration_s))
}

/// Scenario under way.
struct Run {
    hob: SimHob,
    host: Host,
    half_cycles: Vec<TrueHalfCycle>,
    faults: FaultLog,
    marks: Vec<Mark>,
    surroundings: Surroundings,
    energy_j: f64,
    /// Level of the panel; `None` before a user has touched it.
    panel_level: Option<u8>,
}

impl Run {
    fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let file = &scenario.file;
        let config = file.hob();
        let mut hob = SimHob::assemble(&config)?;
        let mut host = Host::new(&mut hob);
        if file.give_up_s.is_some() || file.dither_permille.is_some() {
            let usual = Configure::DEFAULT;
            host.configure(
                &mut hob,
                &Configure {
                    give_up_s: file.give_up_s.map_or(usual.give_up_s, |s| s as u16),
                    dither_permille: file
                        .dither_permille
                        .map_or(usual.dither_permille, |p| p as u8),
                },
            );
        }
        Ok(Self {
            hob,
            host,
            half_cycles: Vec::new(),
            faults: FaultLog::default(),
            marks: Vec::new(),
            surroundings: Surroundings::default(),
            energy_j: 0.0,
            panel_level: None,
        })
    }

    fn apply(&mut self, timed: &TimedChange) -> Result<(), ScenarioError> {
        self.surroundings.apply_to_hob(&mut self.hob, timed)?;
        let (hob, host) = (&mut self.hob, &mut self.host);
        let now_s = hob.t_s();
        let mut kind = timed.change.kind();
        match &timed.change {
            TimelineChange::Power(power_w) => host.set_power(hob, *power_w),
            TimelineChange::Inject(_) => self.faults.injected(now_s),
            TimelineChange::Panel(PanelEvent::Level(level)) => {
                self.panel_level = Some(*level);
                kind = Kind::Power(hob.housekeeping().control().asked_w());
            }
            TimelineChange::Panel(PanelEvent::KeepWarm) => self.panel_level = Some(KEEP_WARM_LEVEL),
            TimelineChange::Panel(_)
            | TimelineChange::Pot(_)
            | TimelineChange::PotBack(_)
            | TimelineChange::Mains(_)
            | TimelineChange::MainsBack(_)
            | TimelineChange::InjectEnd(_)
            | TimelineChange::Pass(_)
            | TimelineChange::Ambient(_)
            | TimelineChange::HeatSink(_)
            | TimelineChange::Glass(_) => {}
            TimelineChange::Silent => host.fall_silent(),
            TimelineChange::ClearFault => host.clear_fault(hob),
            TimelineChange::ResetLookup => host.reset_lookup(hob),
            TimelineChange::PushLookup(lookup) => host.push_lookup(hob, lookup),
            TimelineChange::Repeat {
                what,
                every_s,
                until_s,
            } => host.repeat(*what, *every_s, *until_s, now_s),
        }
        self.marks.push(Mark { at_s: now_s, kind });
        Ok(())
    }

    /// Records the half-cycle that ended in this block; returns `false` if none did.
    fn take_half_cycle(&mut self) -> bool {
        let Some(reading) = self.hob.take_reading() else {
            return false;
        };
        self.energy_j += reading.energy_j;
        let drive = self.hob.sampling_path().drive();
        let f_sw_hz = match drive.is_switching() {
            true => f64::from(drive.f_sw_hz),
            false => 0.0,
        };
        let housekeeping = self.hob.housekeeping();
        let (seen, control) = (housekeeping.summary(), housekeeping.control());
        self.half_cycles.push(TrueHalfCycle {
            t_s: reading.t_s,
            // With a panel the firmware combines it with the host's request.
            asked_w: f64::from(match self.panel_level {
                Some(_) => control.asked_w(),
                None => self.host.asked_w(),
            }),
            power_w: reading.power_w(),
            measured_w: f64::from(seen.power_mw) * 1e-3,
            f_sw_hz,
            state: control.state().name().to_owned(),
            fault: format!("{:?}", self.faults.active()),
            pot: control.pot().name().to_owned(),
            off_reason: control.off_reason().name().to_owned(),
            limit: control.limit().name().to_owned(),
            base_c: self.hob.thermal().map(ThermalModel::temperature_c),
            contents_c: self.hob.thermal().and_then(ThermalModel::bulk_c),
            glass_hot: control.temperatures().is_glass_hot(),
            r_ohm: seen.crest.r.ohm(),
            l_uh: seen.crest.l.henry() * 1e6,
            i_peak_a: reading.i_peak_a,
            v_coil_peak_v: reading.v_coil_peak_v,
            i_turn_off_min_a: reading.i_turn_off_min_a,
            hard_edges: reading.hard_edges,
            bridge_on: reading.bridge_on(),
        });
        true
    }

    fn finish(self, duration_s: f64) -> Record {
        let locked = self.hob.housekeeping().control().state() == State::LockedOut;
        let mut summary = summary::summarise(&self.half_cycles, &self.marks, duration_s);
        summary.latched = locked && (self.host.asked_w() > 0 || self.panel_level > Some(0));
        summary.energy_j = self.energy_j;
        summary.watchdog_bites = self.hob.watchdog_bites();
        Record {
            half_cycles: self.half_cycles,
            faults: self.faults.finish(),
            summary,
        }
    }
}
