//! Case of the matrix, and the building blocks of its simulated captures.

use ihd_identify::Method;
use ihd_shared::hob::{F_SW_MAX_HZ, F_SW_MIN_HZ, RESONANCE_CAPACITANCE_NF};
use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind};
use serde::Serialize;

use super::damage::CaptureDamage;

/// Soundness of a capture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CaptureGroup {
    /// Sound: refusing a correct result is a false refusal.
    Clean,
    /// Sensing, load or carrier have a defect that can make R and L wrong.
    Faulty,
    /// Faulty, and no capture can show it: another gain and another capacitor cannot be distinguished.
    Invisible,
}

/// Capture of the matrix; its noise has a seed.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Name of its speciality.
    pub name: String,
    /// Soundness.
    pub group: CaptureGroup,
    /// `true` if it belongs to the short form.
    pub short: bool,
    /// Specification of the simulation.
    pub settings: CaptureSpec,
    /// Damage done to the samples afterwards.
    pub damage: Vec<CaptureDamage>,
    /// Value of the resonance capacitor in farad, if the user states it.
    pub capacitance_f: Option<f64>,
}

impl Case {
    pub(super) fn clean(name: impl Into<String>, settings: CaptureSpec) -> Self {
        Self {
            name: name.into(),
            group: CaptureGroup::Clean,
            short: false,
            settings,
            damage: Vec::new(),
            capacitance_f: None,
        }
    }

    pub(super) fn faulty(name: impl Into<String>, settings: CaptureSpec) -> Self {
        Self {
            group: CaptureGroup::Faulty,
            ..Self::clean(name, settings)
        }
    }

    pub(super) fn invisible(name: impl Into<String>, settings: CaptureSpec) -> Self {
        Self {
            group: CaptureGroup::Invisible,
            ..Self::clean(name, settings)
        }
    }

    /// Number of seeds to run of those asked for: all seeds make the same capture where nothing is random.
    pub fn seeds(&self, asked: u64) -> u64 {
        let sensing = &self.settings.sensing;
        match sensing.snr_db.is_some() || sensing.spikes_per_s > 0.0 {
            true => asked,
            false => 1,
        }
    }

    /// Returns `true` if a method applies to such a capture: the firmware's chain works at the hob's own frequencies.
    pub fn suits(&self, method: Method) -> bool {
        let own = f64::from(F_SW_MIN_HZ)..=f64::from(F_SW_MAX_HZ);
        method != Method::Firmware || own.contains(&self.settings.f_sw_hz)
    }

    pub(super) fn damaged(self, damage: CaptureDamage) -> Self {
        let damage = [self.damage.as_slice(), &[damage]].concat();
        Self { damage, ..self }
    }

    /// States the value of the resonance capacitor.
    pub(super) fn with_capacitance(self) -> Self {
        let capacitance_f = Some(f64::from(RESONANCE_CAPACITANCE_NF) * 1e-9);
        Self {
            capacitance_f,
            ..self
        }
    }

    pub(super) fn short(self) -> Self {
        Self {
            short: true,
            ..self
        }
    }
}

/// Base of all cases: two mains half-cycles of the behavioural reference load at 45 kHz on a scope of 12.5 MS/s, 12 bit and 50 dB.
pub(super) fn base() -> CaptureSpec {
    let mut s = CaptureSpec {
        load: LoadKind::Behavioural,
        ..CaptureSpec::default()
    };
    s.sensing.rate = Rate::Hz(12.5e6);
    s.sensing.bits = 12;
    s.sensing.snr_db = Some(50.0);
    s
}

/// Returns [`base`] with a change.
pub(super) fn with(change: impl FnOnce(&mut CaptureSpec)) -> CaptureSpec {
    let mut s = base();
    change(&mut s);
    s
}

/// Sets a rate at which edges alias intentionally.
pub(super) fn at_rate(s: &mut CaptureSpec, rate_hz: f64) {
    s.sensing.rate = Rate::Hz(rate_hz);
    s.sensing.allow_aliasing = true;
}

/// Sets the sensing chain of the hob's own board: 61/3, 12 bit, a filter of 500 kHz in both channels.
pub(super) fn as_device(s: &mut CaptureSpec) {
    s.sensing.rate = Rate::Locked;
    s.sensing.pole_hz = f64::from(ANTI_ALIAS_HZ);
    s.sensing.snr_db = None;
}

/// Sets a load of R 0.35 ohm: aluminium, above its resonance of 46 kHz.
pub(super) fn aluminium(s: &mut CaptureSpec) {
    s.load = LoadKind::Surrogate;
    s.pot = SimulatedPot::new(PotBase::Aluminium, 0.21);
    s.winding_r_ohm = 0.14;
    s.f_sw_hz = 67e3;
    s.sensing.i_full_scale_a = 160.0;
}
