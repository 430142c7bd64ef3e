//! What is learned of one device's load: one window after the other, until a lookup is worth pushing.
//!
//! ```text
//! Window ─► network ─► gate ─► Curve ─► PotMap ─► worth pushing? ─► lookup to push
//!           network.rs gate.rs          ihd-map   news.rs           version.rs
//! ```
//!
//! [`Learning`] talks to no device: whoever does pushes what [`Learning::observe`] builds, and tells it
//! what became of that. Its state is bytes ([`Learning::to_bytes`]), so that a restart learns nothing anew.

mod answer;
mod gate;
mod lag;
mod network;
mod news;
mod sensors;
mod state;
#[cfg(test)]
mod tests;
mod version;

use std::sync::Arc;

use ihd_link::Window;
use ihd_map::{Curve, Library, PotMap, Predicted, Seen};
use ihd_pinn::{Config, Identified, Parameters};
use ihd_shared::lookup::RlLookup;
use ihd_signal::Remark;

use self::answer::alone;
use self::lag::Lag;
use self::sensors::corrected;
use self::version::Versions;
use crate::lookup::Built;

pub use self::answer::{Alone, Believed, Disbelief, identify_alone};
pub use self::gate::judge;
pub use self::network::{Found, curve, identify_window};
pub use self::news::Contradiction;
pub use self::sensors::{Evidence, SELF_CALIBRATED, Sensors};
pub use self::state::DamagedState;

/// Most windows that are learned in silence after a device has refused lookups one after the other: at
/// five windows a second some three minutes.
const LONGEST_SILENCE: u32 = 1_024;

/// What one device's windows have taught.
#[derive(Clone, Debug)]
pub struct Learning {
    network: Config,
    map: PotMap,
    lag: Lag,
    sensors: Sensors,
    /// The network of the last window that was fit, which the next one starts from.
    warm: Option<Parameters>,
    /// The lookup that was built last, which the next window is compared with.
    offered: Option<RlLookup>,
    versions: Versions,
    /// Lookups that the device refused in a row.
    refusals: u32,
    /// Windows that are still to be learned before the next lookup is offered.
    silence: u32,
    /// The device's boot that a window was taken of last ([`Learning::take`]).
    boot: Option<u32>,
}

/// What became of a window.
#[derive(Clone, Debug)]
pub enum Outcome {
    /// It may teach.
    Fit(Box<Fit>),
    /// It may not, and nothing was learned.
    Unfit {
        /// Why.
        why: String,
        /// What the network found, where it came to an end.
        identified: Option<Box<Identified>>,
        /// What is to be said of it, worst first.
        findings: Vec<Remark>,
    },
}

/// A window that may teach.
#[derive(Clone, Debug)]
pub struct Fit {
    /// R(t) and L(t), with all that the network says of them.
    pub identified: Identified,
    /// What is to be said of them beside, worst first; no errors.
    pub findings: Vec<Remark>,
    /// Whether it is the pot that was known.
    pub seen: Seen,
    /// What it means for the lookup.
    pub taught: Taught,
}

/// What a window means for the lookup.
#[derive(Clone, Debug)]
pub enum Taught {
    /// Nothing new: the lookup that was built last says the same.
    Known,
    /// A lookup to push.
    News(Box<Built>),
    /// No lookup that a device would take rests on this window; it is forgotten.
    Refused(String),
}

impl Learning {
    /// Knows nothing yet.
    pub fn new(network: Config) -> Self {
        Self {
            network: Config {
                start: None,
                ..network
            },
            map: PotMap::default(),
            lag: Lag::default(),
            sensors: Sensors::default(),
            warm: None,
            offered: None,
            versions: Versions::default(),
            refusals: 0,
            silence: 0,
            boot: None,
        }
    }

    /// The device uses the lookup of this version, which is what counts where another was offered: after
    /// a handshake, and after a reset of its lookup.
    pub fn device_has(&mut self, version: u32) {
        self.versions.device = version;
        if self.offered.as_ref().is_some_and(|l| l.version != version) {
            self.offered = None;
        }
        self.refusals = 0;
        self.silence = 0;
    }

    /// The device has made an offered lookup its own.
    pub fn accepted(&mut self, version: u32) {
        self.versions.device = version;
        self.refusals = 0;
        self.silence = 0;
    }

    /// The device has refused an offered lookup. The next one is offered after a pause that doubles from
    /// refusal to refusal.
    pub fn refused(&mut self, version: u32) {
        if self.offered.as_ref().is_some_and(|l| l.version == version) {
            self.offered = None;
        }
        self.refusals = self.refusals.saturating_add(1);
        let pause = 1u32.checked_shl(self.refusals).unwrap_or(LONGEST_SILENCE);
        self.silence = pause.min(LONGEST_SILENCE);
    }

    /// Forgets the load, not the versions: no two lookups of a device have one number.
    pub fn forget(&mut self) {
        *self = Self {
            versions: self.versions,
            // The load is forgotten, the board is the same, and so is what others know.
            sensors: self.sensors,
            map: self.map.forgotten(),
            ..Self::new(self.network.clone())
        };
    }

    /// Asks these pots, which other hobs know, when it sees one for the first time. They are no part of [`Learning::to_bytes`]:
    /// whoever restores a state gives them again.
    pub fn use_library(&mut self, library: Arc<Library>) {
        self.map = std::mem::take(&mut self.map).with_library(library);
    }

    /// What the windows showed of the device's sensors.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// The first place at which somebody else's lookup contradicts what the device's windows showed of its pot.
    pub fn contradiction(&self, lookup: &RlLookup) -> Option<Contradiction> {
        let curves = self.map.curves().iter();
        curves
            .into_iter()
            .find_map(|curve| news::contradiction(curve, lookup))
    }

    /// The next window's network starts from nothing.
    pub fn start_cold(&mut self) {
        self.warm = None;
    }

    /// Switching frequencies at which the pot was seen.
    pub fn curves(&self) -> usize {
        self.map.curves().len()
    }

    /// What is known of the pot.
    pub fn map(&self) -> &PotMap {
        &self.map
    }

    /// R(t) and L(t) of a window from all windows of this pot, at the times of what the network found; empty where there
    /// was none.
    pub fn learned(&self, window: &Window, identified: &Identified) -> Vec<Predicted> {
        let (f_hz, now_s) = (f64::from(window.f_sw_hz), time_s(window));
        self.map.along(f_hz, &self.lag.behind(identified), now_s)
    }

    /// Cells of the lookup that was built last that rest on observations.
    pub fn observed_cells(&self) -> u32 {
        self.offered.as_ref().map_or(0, RlLookup::observed_cells)
    }

    /// Learns from a window. `always` builds a lookup even of what is no news; `on_step` hears of each step
    /// of the network.
    pub fn observe(
        &mut self,
        window: &Window,
        always: bool,
        on_step: &mut dyn FnMut(&ihd_pinn::Progress),
    ) -> Outcome {
        let config = Config {
            start: self.warm.take(),
            ..self.network.clone()
        };
        let raw = window.segment();
        let evidence = Evidence::of(&raw);
        let mut said = evidence.remarks.clone();
        said.extend(self.hear(&evidence));
        let segment = corrected(&raw, self.sensors.correction().as_ref());
        let (identified, findings, verdict) = alone(window, &segment, config, said, on_step);
        let (identified, curve) = match (identified, verdict) {
            (Some(identified), Ok(curve)) => (*identified, curve),
            (identified, verdict) => {
                return Outcome::Unfit {
                    why: verdict.err().unwrap_or_default(),
                    identified,
                    findings,
                };
            }
        };
        self.warm = Some(identified.parameters.clone());
        let (seen, taught) = self.learn(curve, always);
        let (f_hz, now_s) = (f64::from(window.f_sw_hz), time_s(window));
        let law = self.map.along(f_hz, &identified.i_amplitude_a, now_s);
        self.lag.look(&identified, &law);
        Outcome::Fit(Box::new(Fit {
            identified,
            findings,
            seen,
            taught,
        }))
    }

    fn learn(&mut self, curve: Curve, always: bool) -> (Seen, Taught) {
        let (now_s, before) = (curve.t_s, self.curves());
        self.map.rebase(now_s);
        let differs = self
            .offered
            .as_ref()
            .is_none_or(|l| news::differs(&curve, l));
        let seen = self.map.observe(curve);
        self.silence = self.silence.saturating_sub(1);
        // Another frequency tells of cells that nobody saw.
        let says_more = self.curves() != before;
        if !always && ((!differs && !says_more) || self.silence > 0) {
            return (seen, Taught::Known);
        }
        (seen, self.build(now_s, always || differs))
    }

    fn build(&mut self, now_s: f64, whatever: bool) -> Taught {
        self.map.refresh(now_s);
        let Some(cells) = self.map.cells(now_s) else {
            return Taught::Refused("the window shows no load".to_owned());
        };
        let Some(version) = self.versions.next() else {
            return Taught::Refused(format!(
                "the device's lookup has version {}, the highest that there is; reset it",
                self.versions.device
            ));
        };
        let built = match Built::of(cells, version) {
            Ok(built) => built,
            Err(why) => return Taught::Refused(why.to_string()),
        };
        let known = self.offered.as_ref();
        if !whatever && known.is_some_and(|offered| !news::cells_differ(&built.lookup, offered)) {
            return Taught::Known;
        }
        self.versions.offered = version;
        self.offered = Some(built.lookup.clone());
        Taught::News(Box::new(built))
    }
}

/// Time of a window in seconds since its device was reset.
fn time_s(window: &Window) -> f64 {
    1e-9 * f64::from(window.half_cycle) * f64::from(window.half_cycle_ns)
}
