//! Learning of one device's load, window by window, until a lookup is worth pushing.
//!
//! ```text
//! Window ─► fit_window ─► gate ─► CurrentCurve ─► PotMap ─► LookupBuilder ─► lookup to push
//!           network.rs    gate.rs          ihd-map   lookup_builder.rs, significance.rs, version.rs
//! ```
//!
//! [`Learning`] has no connection to a device: the caller pushes the lookup that [`Learning::observe`] builds and reports the device's
//! reply ([`Learning::lookup_accepted`], [`Learning::lookup_refused`]). Its state is stored as bytes ([`Learning::to_bytes`]), so that
//! nothing is lost in a restart.

mod answer;
mod gate;
mod lag;
mod lookup_builder;
mod network;
mod sensors;
mod significance;
mod state;
#[cfg(test)]
mod tests;
mod version;

use std::sync::Arc;

use ihd_link::Window;
use ihd_map::{CurrentCurve, CurveMatch, Library, PotMap, RlPrediction};
use ihd_pinn::{Identification, Parameters, PinnConfig};
use ihd_shared::lookup::RlLookup;
use ihd_signal::Remark;

use self::answer::analyse_segment;
use self::lag::Lag;
use self::lookup_builder::LookupBuilder;
use self::sensors::corrected;
use crate::lookup::BuiltLookup;

pub use self::answer::{AnswerError, ConfirmedAnswer, WindowAnalysis, analyse_window};
pub use self::gate::judge;
pub use self::network::{LoadTrajectory, curve, fit_window};
pub use self::sensors::{SELF_CALIBRATED, SensorEvidence, Sensors, anti_alias_loss, unfiltered};
pub use self::significance::Contradiction;
pub use self::state::StateError;

/// Longest half-cycle of a 60 Hz mains in nanoseconds: that of 55 Hz.
const MAX_60_HZ_NS: u32 = 9_090_909;

/// State learned from one device's windows: the pot's map, the sensors, and the lookups offered so far.
#[derive(Clone, Debug)]
pub struct Learning {
    network: PinnConfig,
    map: PotMap,
    lag: Lag,
    sensors: Sensors,
    /// Network parameters of the last accepted window, from which the next one starts.
    warm: Option<Parameters>,
    builder: LookupBuilder,
    /// Present boot of the device; `None` if its caller tells no boots ([`Learning::begin_boot`]).
    boot: Option<u32>,
}

/// Result of a window.
#[derive(Clone, Debug)]
pub enum WindowOutcome {
    /// The gate accepts it, and it was learned.
    Accepted(Box<AcceptedWindow>),
    /// The gate refuses it, and nothing was learned.
    Refused {
        /// Reason of the refusal.
        why: String,
        /// R(t) and L(t); `None` if the network did not finish.
        identified: Option<Box<Identification>>,
        /// Findings, worst first.
        findings: Vec<Remark>,
    },
}

/// Window that the gate accepts.
#[derive(Clone, Debug)]
pub struct AcceptedWindow {
    /// R(t) and L(t), with the network's figures.
    pub identified: Identification,
    /// Findings, worst first; none is an error.
    pub findings: Vec<Remark>,
    /// Comparison with the known pot: the same one, or another.
    pub seen: CurveMatch,
    /// Effect on the lookup.
    pub taught: LookupUpdate,
}

/// Effect of a window on the lookup.
#[derive(Clone, Debug)]
pub enum LookupUpdate {
    /// The lookup that was built last still holds.
    Unchanged,
    /// New lookup to push.
    New(Box<BuiltLookup>),
    /// No lookup that a device would accept follows from this window; the text is the reason.
    Refused(String),
}

impl Learning {
    /// Creates the state of an unknown device.
    pub fn new(network: PinnConfig) -> Self {
        Self {
            network: PinnConfig {
                start: None,
                ..network
            },
            map: PotMap::default(),
            lag: Lag::default(),
            sensors: Sensors::default(),
            warm: None,
            builder: LookupBuilder::default(),
            boot: None,
        }
    }

    /// Sets the version of the lookup that the device uses, after a handshake and after a reset of its lookup. An offered lookup of another
    /// version is dropped.
    pub fn set_device_version(&mut self, version: u32) {
        self.builder.set_device_version(version);
    }

    /// Sets the device's present boot, after a handshake. What was learned before is at least as old as the boot.
    pub fn begin_boot(&mut self, boot: u32) {
        if self.boot.is_some_and(|before| before != boot) {
            self.map.rebase(0.0);
        }
        self.boot = Some(boot);
    }

    /// Returns `true` if a window of this boot may show the load of now: the boot is the device's present one, or that is not known.
    pub fn is_present(&self, boot: u32) -> bool {
        self.boot.is_none_or(|present| present == boot)
    }

    /// Records that the device has accepted an offered lookup.
    pub fn lookup_accepted(&mut self, version: u32) {
        self.builder.accepted(version);
    }

    /// Records that the device has refused an offered lookup. The next one is offered after a pause that doubles with every refusal in a
    /// row.
    pub fn lookup_refused(&mut self, version: u32) {
        self.builder.refused(version);
    }

    /// Forgets the load. The versions stay, so that no two lookups of a device have the same number.
    pub fn forget(&mut self) {
        *self = Self {
            builder: self.builder.forgotten(),
            // The board is the same, and the map keeps the library of other hobs' pots.
            sensors: self.sensors,
            map: self.map.forgotten(),
            boot: self.boot,
            ..Self::new(self.network.clone())
        };
    }

    /// Forgets the load and the sensors: the device is another board.
    pub fn forget_board(&mut self) {
        self.forget();
        self.sensors = Sensors::default();
    }

    /// Sets the library of pots that other hobs know, for use with a pot that is new here. It is no part of [`Learning::to_bytes`] and must
    /// be set again after [`Learning::from_bytes`].
    pub fn use_library(&mut self, library: Arc<Library>) {
        self.map = std::mem::take(&mut self.map).with_library(library);
    }

    /// Returns the estimates of the device's sensor errors.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// Returns the first place at which a lookup contradicts the device's windows.
    pub fn contradiction(&self, lookup: &RlLookup) -> Option<Contradiction> {
        let curves = self.map.curves().iter();
        curves
            .into_iter()
            .find_map(|curve| significance::contradiction(curve, lookup))
    }

    /// Discards the network parameters, so that the next window starts cold.
    pub fn start_cold(&mut self) {
        self.warm = None;
    }

    /// Returns the number of switching frequencies at which the pot was observed.
    pub fn curve_count(&self) -> usize {
        self.map.curves().len()
    }

    /// Returns the pot's map.
    pub fn map(&self) -> &PotMap {
        &self.map
    }

    /// Returns the map's R(t) and L(t) for a window, at the times of `identified`; empty if the map holds no window.
    pub fn predict(&self, window: &Window, identified: &Identification) -> Vec<RlPrediction> {
        let (f_hz, now_s) = (f64::from(window.f_sw_hz), time_s(window));
        self.map
            .along(f_hz, &self.lag.lagged_currents_a(identified), now_s)
    }

    /// Returns the number of observed cells of the lookup that was built last.
    pub fn observed_cells(&self) -> u32 {
        self.builder
            .offered
            .as_ref()
            .map_or(0, RlLookup::observed_cells)
    }

    /// Learns from a window. `always` builds a lookup even if nothing has changed; `on_step` is called after each step of the network.
    pub fn observe(
        &mut self,
        window: &Window,
        always: bool,
        on_step: &mut dyn FnMut(&ihd_pinn::TrainingProgress),
    ) -> WindowOutcome {
        let config = PinnConfig {
            start: self.warm.take(),
            ..self.network.clone()
        };
        let raw = window.segment();
        let evidence = SensorEvidence::of_window(window.seq, &raw);
        let mut sensor_remarks = evidence.remarks.clone();
        sensor_remarks.extend(self.count_evidence(&evidence));
        let segment = corrected(&raw, self.sensors.correction().as_ref());
        let (identified, findings, verdict) =
            analyse_segment(window, &segment, config, sensor_remarks, on_step);
        let (identified, curve) = match (identified, verdict) {
            (Some(identified), Ok(curve)) => (*identified, curve),
            (identified, verdict) => {
                return WindowOutcome::Refused {
                    why: verdict.err().unwrap_or_default(),
                    identified,
                    findings,
                };
            }
        };
        self.warm = Some(identified.parameters.clone());
        let (seen, taught) = self.learn(curve, always);
        if self.lag.takes_next() {
            let (f_hz, now_s) = (f64::from(window.f_sw_hz), time_s(window));
            let law = self.map.along(f_hz, &identified.i_amplitude_a, now_s);
            self.lag.add_window(&identified, &law);
        }
        WindowOutcome::Accepted(Box::new(AcceptedWindow {
            identified,
            findings,
            seen,
            taught,
        }))
    }

    fn learn(&mut self, curve: CurrentCurve, always: bool) -> (CurveMatch, LookupUpdate) {
        let now_s = curve.t_s;
        self.map.rebase(now_s);
        let differs = self.builder.is_outdated_by(&curve);
        let seen = self.map.observe(curve);
        let pauses = self.builder.pauses();
        // A new frequency, or twice the windows at a known one: predicted cells change too, or become known.
        let newest = self
            .map
            .curves()
            .iter()
            .max_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let says_more = newest.is_some_and(|curve| curve.windows.is_power_of_two());
        if !always && ((!differs && !says_more) || pauses) {
            return (seen, LookupUpdate::Unchanged);
        }
        self.map.refresh(now_s);
        let update = self.builder.build(self.map.cells(now_s), always || differs);
        (seen, update)
    }
}

/// Time of a window in seconds since its device's reset, by half-cycles of the nominal mains. Those of a window differ from one to the
/// next by some 1e-4 of them, which after days would be minutes between two windows of the same second.
fn time_s(window: &Window) -> f64 {
    let nominal_hz = match window.half_cycle_ns > MAX_60_HZ_NS {
        true => 50.0,
        false => 60.0,
    };
    f64::from(window.half_cycle) / (2.0 * nominal_hz)
}
