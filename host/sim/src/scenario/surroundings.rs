//! Changes around a hob: pot, mains, heat, faults of sensors, a person at the panel, and their restoration.

use std::collections::BTreeMap;

use super::file::MainsField;
use super::timeline::{TimedChange, TimelineChange};
use crate::hob::SimHob;
use crate::injection::Injections;
use crate::inverter::InverterError;
use crate::mains::SimulatedMains;
use crate::plant::Plant;
use crate::pot::SimulatedPot;

/// Hob whose surroundings change: the simulated one, or an image's board.
pub trait ChangeableHob {
    /// Its power stage.
    fn plant(&mut self) -> &mut Plant;

    /// Changes the injected faults.
    fn inject(&mut self, change: impl FnOnce(&mut Injections));

    /// Sets the heat sink's temperature in °C.
    fn set_heat_sink(&mut self, celsius: f64);

    /// Sets the temperature of the glass and its sensor in °C.
    fn set_glass(&mut self, celsius: f64);
}

impl ChangeableHob for SimHob {
    fn plant(&mut self) -> &mut Plant {
        self.plant_mut()
    }

    fn inject(&mut self, change: impl FnOnce(&mut Injections)) {
        self.inject(change);
    }

    fn set_heat_sink(&mut self, celsius: f64) {
        self.temperatures().heat_sink_c = celsius;
    }

    fn set_glass(&mut self, celsius: f64) {
        self.temperatures().set_glass(celsius);
    }
}

/// State before each event that is restored later.
#[derive(Default)]
pub struct Surroundings {
    pots: BTreeMap<usize, SimulatedPot>,
    mains: BTreeMap<usize, SimulatedMains>,
    injected: BTreeMap<usize, u32>,
}

impl Surroundings {
    /// Prepares every pot of the events, so that putting it on takes no time.
    ///
    /// # Errors
    /// If there is no model of a pot.
    pub fn prepare(plant: &mut Plant, events: &[TimedChange]) -> Result<(), InverterError> {
        for timed in events {
            if let TimelineChange::Pot(pot) = &timed.change {
                plant.prepare(pot)?;
            }
        }
        Ok(())
    }

    /// Applies a change of any kind but the host's, which has no effect.
    ///
    /// # Errors
    /// If there is no model of a pot; the old one stays.
    pub(super) fn apply_to_hob(
        &mut self,
        hob: &mut SimHob,
        timed: &TimedChange,
    ) -> Result<(), InverterError> {
        match &timed.change {
            TimelineChange::Panel(touch) => hob.panel(*touch),
            TimelineChange::Pass(minutes) => hob.pass_minutes(*minutes),
            TimelineChange::Ambient(celsius) => hob.temperatures().ambient_c = *celsius,
            _ => self.apply(hob, timed)?,
        }
        Ok(())
    }

    /// Applies a change of pot, mains, heat sink or glass, or of the injected faults; any other has no effect.
    ///
    /// # Errors
    /// If there is no model of a pot; the old one stays.
    pub fn apply(
        &mut self,
        hob: &mut impl ChangeableHob,
        timed: &TimedChange,
    ) -> Result<(), InverterError> {
        let event = timed.event;
        match &timed.change {
            TimelineChange::Pot(pot) => {
                self.pots.insert(event, hob.plant().pot());
                hob.plant().set_pot(*pot)?;
            }
            TimelineChange::PotBack(event) => {
                if let Some(pot) = self.pots.remove(event) {
                    hob.plant().set_pot(pot)?;
                }
            }
            TimelineChange::Mains(MainsField {
                v_rms, hz, open, ..
            }) => {
                let before = hob.plant().mains();
                self.mains.insert(event, before);
                let v_rms_v = v_rms.unwrap_or(before.v_rms_v());
                hob.plant()
                    .change_mains(v_rms_v, hz.unwrap_or(before.frequency_hz));
                hob.plant().set_line_open(open.unwrap_or(before.is_open));
            }
            TimelineChange::MainsBack(event) => {
                if let Some(before) = self.mains.remove(event) {
                    hob.plant()
                        .change_mains(before.v_rms_v(), before.frequency_hz);
                    hob.plant().set_line_open(before.is_open);
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
            TimelineChange::HeatSink(celsius) => hob.set_heat_sink(*celsius),
            TimelineChange::Glass(celsius) => hob.set_glass(*celsius),
            TimelineChange::Panel(_)
            | TimelineChange::Pass(_)
            | TimelineChange::Ambient(_)
            | TimelineChange::Power(_)
            | TimelineChange::Silent
            | TimelineChange::ClearFault
            | TimelineChange::ResetLookup
            | TimelineChange::PushLookup(_)
            | TimelineChange::Repeat { .. } => {}
        }
        Ok(())
    }
}
