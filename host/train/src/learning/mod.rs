//! What is learned of one device's load: one window after the other, until a lookup is worth pushing.
//!
//! ```text
//! Window ─► network ─► gate ─► LoadCurve ─► Observations ─► worth pushing? ─► lookup to push
//!           network.rs gate.rs              observations.rs is_news           version.rs
//! ```
//!
//! [`Learning`] talks to no device: whoever does pushes what [`Learning::observe`] builds, and tells it
//! what became of that. Its state is bytes ([`Learning::to_bytes`]), so that a restart learns nothing anew.

mod gate;
mod network;
mod observations;
mod sensors;
mod state;
#[cfg(test)]
mod tests;
mod version;

use ihd_gate::Judgement;
use ihd_link::Window;
use ihd_pinn::{Config, Identified, Parameters};
use ihd_shared::lookup::RlLookup;
use ihd_signal::Remark;

use self::observations::{Observations, is_news};
use self::version::Versions;
use crate::lookup::Built;

pub use self::gate::judge;
pub use self::observations::NotTeachable;
pub use self::sensors::Sensors;
pub use self::state::DamagedState;

/// Most windows that are learned in silence after a device has refused lookups one after the other: at
/// five windows a second some three minutes.
const LONGEST_SILENCE: u32 = 1_024;

/// What one device's windows have taught.
#[derive(Clone, Debug)]
pub struct Learning {
    network: Config,
    observations: Observations,
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
    },
}

/// A window that may teach.
#[derive(Clone, Debug)]
pub struct Fit {
    /// R(t) and L(t), with all that the network says of them.
    pub identified: Identified,
    /// What is to be said of them beside, worst first; no errors.
    pub findings: Vec<Remark>,
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
            observations: Observations::default(),
            sensors: Sensors::default(),
            warm: None,
            offered: None,
            versions: Versions::default(),
            refusals: 0,
            silence: 0,
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
            // The load is forgotten, the board is the same.
            sensors: self.sensors,
            ..Self::new(self.network.clone())
        };
    }

    /// What the windows showed of the device's sensors.
    pub fn sensors(&self) -> &Sensors {
        &self.sensors
    }

    /// The next window's network starts from nothing.
    pub fn start_cold(&mut self) {
        self.warm = None;
    }

    /// Load curves that were kept.
    pub fn curves(&self) -> usize {
        self.observations.curves().len()
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
        let (segment, said) = self.sensors.look(&window.segment());
        let identified = match network::identify_window(&segment, config, on_step) {
            Ok(identified) => identified,
            Err(why) => {
                let (why, identified) = (why.to_string(), None);
                return Outcome::Unfit { why, identified };
            }
        };
        let Judgement { findings, gate } = judge(&segment, &identified, &said);
        if gate.refuses() {
            let (why, identified) = (gate.why.join("; "), Some(Box::new(identified)));
            return Outcome::Unfit { why, identified };
        }
        self.warm = Some(identified.parameters.clone());
        let taught = self.learn(network::load_curve(window, &identified), always);
        Outcome::Fit(Box::new(Fit {
            identified,
            findings,
            taught,
        }))
    }

    fn learn(&mut self, curve: crate::lookup::LoadCurve, always: bool) -> Taught {
        let differs = self.offered.as_ref().is_none_or(|l| is_news(&curve, l));
        self.observations.remember(curve);
        self.silence = self.silence.saturating_sub(1);
        if !always && (!differs || self.silence > 0) {
            return Taught::Known;
        }
        let Some(version) = self.versions.next() else {
            return Taught::Refused(format!(
                "the device's lookup has version {}, the highest that there is; reset it",
                self.versions.device
            ));
        };
        match self.observations.build(version) {
            Ok(built) => {
                self.versions.offered = version;
                self.offered = Some(built.lookup.clone());
                Taught::News(Box::new(built))
            }
            Err(why) => Taught::Refused(why.to_string()),
        }
    }
}
