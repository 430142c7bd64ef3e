//! Changes around the hob: pot, mains, panel, heat, faults of sensors, and their restoration.

use std::collections::BTreeMap;

use super::file::MainsField;
use super::timeline::{TimedChange, TimelineChange};
use crate::hob::SimHob;
use crate::inverter::InverterError;
use crate::pot::SimulatedPot;

/// State before each event that is restored later.
#[derive(Default)]
pub(super) struct Surroundings {
    pots: BTreeMap<usize, SimulatedPot>,
    mains: BTreeMap<usize, (f64, f64)>,
    injected: BTreeMap<usize, u32>,
}

impl Surroundings {
    /// Prepares every pot of the events, so that putting it on takes no time.
    ///
    /// # Errors
    /// If there is no model of a pot.
    pub(super) fn prepare(hob: &mut SimHob, events: &[TimedChange]) -> Result<(), InverterError> {
        for timed in events {
            if let TimelineChange::Pot(pot) = &timed.change {
                hob.prepare(pot)?;
            }
        }
        Ok(())
    }

    /// Applies a change; one of the host's has no effect.
    ///
    /// # Errors
    /// If there is no model of a pot; the old one stays.
    pub(super) fn apply(
        &mut self,
        hob: &mut SimHob,
        timed: &TimedChange,
    ) -> Result<(), InverterError> {
        let event = timed.event;
        match &timed.change {
            TimelineChange::Pot(pot) => {
                self.pots.insert(event, hob.pot());
                hob.set_pot(*pot)?;
            }
            TimelineChange::PotBack(event) => {
                if let Some(pot) = self.pots.remove(event) {
                    hob.set_pot(pot)?;
                }
            }
            TimelineChange::Mains(MainsField { v_rms, hz, .. }) => {
                let before = (hob.mains().v_rms_v(), hob.mains().frequency_hz);
                self.mains.insert(event, before);
                hob.set_mains(v_rms.unwrap_or(before.0), hz.unwrap_or(before.1));
            }
            TimelineChange::MainsBack(event) => {
                if let Some((v_rms, hz)) = self.mains.remove(event) {
                    hob.set_mains(v_rms, hz);
                }
            }
            TimelineChange::Inject(injection) => {
                let injected = &mut self.injected;
                hob.inject(|all| {
                    injected.insert(event, all.start(*injection));
                });
            }
            TimelineChange::InjectEnd(event) => {
                if let Some(number) = self.injected.remove(event) {
                    hob.inject(|all| all.end(number));
                }
            }
            TimelineChange::Panel(touch) => hob.panel(*touch),
            TimelineChange::Pass(minutes) => hob.pass_minutes(*minutes),
            TimelineChange::Ambient(celsius) => hob.temperatures().ambient_c = *celsius,
            TimelineChange::HeatSink(celsius) => hob.temperatures().heat_sink_c = *celsius,
            TimelineChange::Glass(celsius) => hob.temperatures().set_glass(*celsius),
            TimelineChange::Power(_)
            | TimelineChange::Silent
            | TimelineChange::ClearFault
            | TimelineChange::ResetLookup
            | TimelineChange::PushLookup(_)
            | TimelineChange::Repeat { .. } => {}
        }
        Ok(())
    }
}
