//! Entry of the library: one pot as one or more hobs measured it.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

use super::LibraryError;
use super::shape::{self, Range, ShapeState};
use crate::PotModel;
use crate::curve::FREQUENCIES_HZ;
use crate::parameters::{self, COUNT, OF_POT};

/// Version of the layout of [`PotEntry`].
pub const ENTRY_VERSION: u32 = 1;

/// Most bytes of an entry.
pub const MAX_ENTRY_BYTES: usize = 2_048;

/// Most bytes of the name of an entry, a hob or a build.
const MAX_NAME: usize = 48;

/// Most hobs that an entry names.
pub(crate) const MAX_HOBS: usize = 8;

/// Numbers of a lower triangle.
const TRIANGLE: usize = COUNT * (COUNT + 1) / 2;

/// Deviation of a pot's own numbers, in spreads of any pot, above which an entry is not worth sharing.
const MIN_SPREADS: f64 = 1.0;

/// Range of currents in ampere that a hob can have.
const CURRENTS_A: std::ops::RangeInclusive<f64> = 0.0..=500.0;

/// Hob and build that measured a pot, and the time.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// Name of the hob: letters, digits, `-`, `_` and `.`. A receiver replaces it by the name under which the sender authenticated,
    /// because an entry may state any name.
    pub hob: String,
    /// Build of the program that fitted the entry.
    pub build: String,
    /// Time of the fit in seconds since 1970.
    pub t_unix_s: u64,
}

/// Range of operating points at which a pot was measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredRange {
    /// Lowest and highest switching frequency in hertz.
    pub f_sw_hz: [f64; 2],
    /// Lowest and highest amplitude of the current in ampere.
    pub i_a: [f64; 2],
    /// Number of switching frequencies.
    pub curves: u32,
    /// Number of windows.
    pub windows: u32,
}

/// Class of a pot's metal, as far as two numbers determine it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MetalClass {
    /// Ferritic steel.
    Ferritic,
    /// Grey cast iron.
    CastIron,
    /// Metal without saturation: austenitic steel, aluminium.
    NotMagnetic,
}

/// One pot of the library.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PotEntry {
    pub(super) version: u32,
    pub(super) id: String,
    pub(super) model: PotModel,
    /// Lower triangle L, row by row, of the seven numbers' covariance L Lᵀ, in their units, in the order of `parameters`.
    pub(super) factor: Vec<f64>,
    pub(super) misfit: [f64; 2],
    /// Map less the model in ln R and ln L, in units of 1e-5.
    pub(super) shape: Vec<i16>,
    pub(super) seen: MeasuredRange,
    pub(super) label: Option<String>,
    pub(super) hobs: Vec<String>,
    pub(super) build: String,
    pub(super) t_unix_s: u64,
}

/// Result of a hob's own fit.
pub(crate) struct ExportedFit {
    pub model: PotModel,
    /// Lower triangle of the factor L of the numbers' covariance L Lᵀ.
    pub factor: DMatrix<f64>,
    pub misfit: [f64; 2],
    /// ln of the map less ln of the model, at [`super::shape_places`].
    pub beside: DVector<f64>,
    pub seen: MeasuredRange,
}

impl PotEntry {
    /// Creates an entry from a fit; `None` if a number is outside the range of entries.
    pub(crate) fn from_fit(fit: &ExportedFit, by: Provenance) -> Option<Self> {
        let ExportedFit {
            model,
            factor,
            misfit,
            beside,
            seen,
        } = fit;
        let triangle = (0..COUNT).flat_map(|row| (0..=row).map(move |k| factor[(row, k)]));
        let entry = Self {
            version: ENTRY_VERSION,
            id: format!("{}-{}", by.hob, by.t_unix_s),
            model: *model,
            factor: triangle.collect(),
            misfit: *misfit,
            shape: shape::codes(beside),
            seen: *seen,
            label: None,
            hobs: vec![by.hob],
            build: by.build,
            t_unix_s: by.t_unix_s,
        };
        entry.check().is_ok().then_some(entry)
    }

    /// Returns the entry with a label that users gave the pot.
    #[must_use]
    pub fn labelled(self, label: &str) -> Self {
        Self {
            label: Some(label.to_owned()),
            ..self
        }
    }

    /// Name of the entry: that of the hob that saw the pot first, and the time.
    pub fn id(&self) -> &str {
        &self.id
    }

    /// Label that users gave the pot.
    pub fn label(&self) -> Option<&str> {
        self.label.as_deref()
    }

    /// Pot as the last hob measured it: lift and offset depend on its place, turns and winding on that hob's coil.
    pub fn model(&self) -> &PotModel {
        &self.model
    }

    /// Deviations of ln R and ln L around the physics.
    pub fn misfit(&self) -> [f64; 2] {
        self.misfit
    }

    /// Range of operating points at which the pot was measured.
    pub fn measured_range(&self) -> MeasuredRange {
        self.seen
    }

    /// Hobs that measured it, the first one first; at most eight.
    pub fn hobs(&self) -> &[String] {
        &self.hobs
    }

    /// Build of the program that fitted it last.
    pub fn build(&self) -> &str {
        &self.build
    }

    /// Time of the last fit in seconds since 1970.
    pub fn t_unix_s(&self) -> u64 {
        self.t_unix_s
    }

    /// Diameter of its base in metre, and its deviation.
    pub fn diameter_m(&self) -> (f64, f64) {
        let deviation_m = self.covariance()[(2, 2)].sqrt();
        (2.0 * self.model.radius_m, 2.0 * deviation_m)
    }

    /// Class of the metal, from α and s, which heat and place change less than metals differ.
    pub fn metal(&self) -> MetalClass {
        // Between the classes of `parameters`, in ln α and ln s: 304 and aluminium let a tenth through of what iron does.
        if self.model.ln_s < 4e-6_f64.ln() {
            MetalClass::NotMagnetic
        } else if self.model.ln_alpha < 2_900.0_f64.ln() {
            MetalClass::Ferritic
        } else {
            MetalClass::CastIron
        }
    }

    /// Serialises as JSON, below [`MAX_ENTRY_BYTES`].
    pub fn to_bytes(&self) -> Vec<u8> {
        // Text and numbers: nothing of it can fail to be JSON.
        serde_json::to_vec(self).unwrap_or_default()
    }

    /// Reads and checks bytes from an untrusted source.
    ///
    /// # Errors
    /// [`LibraryError`] if the bytes are no entry that a hob can have produced.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LibraryError> {
        #[derive(Deserialize)]
        struct Version {
            version: u32,
        }
        if bytes.len() > MAX_ENTRY_BYTES {
            return Err(LibraryError::TooLarge {
                bytes: bytes.len(),
                most: MAX_ENTRY_BYTES,
            });
        }
        let Version { version } = serde_json::from_slice(bytes)?;
        if version != ENTRY_VERSION {
            return Err(LibraryError::Version(version));
        }
        let entry: Self = serde_json::from_slice(bytes)?;
        entry.check()?;
        Ok(entry)
    }

    /// Checks that a hob can have found these numbers.
    ///
    /// # Errors
    /// [`LibraryError`] with the number that is wrong.
    pub fn check(&self) -> Result<(), LibraryError> {
        let unsound = |what| Err(LibraryError::Unsound(what));
        if self.version != ENTRY_VERSION {
            return Err(LibraryError::Version(self.version));
        }
        let names = self.hobs.iter().chain([&self.id, &self.build]);
        if !names.into_iter().all(|name| is_name(name)) || self.hobs.is_empty() {
            return unsound("a name");
        }
        if self.hobs.len() > MAX_HOBS || self.label.as_deref().is_some_and(|l| !is_label(l)) {
            return unsound("too many or too long names");
        }
        if !parameters::is_sound(&self.model) {
            return unsound("a number of the pot");
        }
        let wide = |row: usize| {
            let numbers = self.row(row);
            let sigma = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
            let most = if row < OF_POT { MIN_SPREADS } else { 2.0 };
            let within = sigma <= most * parameters::SPREAD[row];
            !(within && numbers[row] >= 1e-6 * parameters::SPREAD[row])
        };
        if self.factor.len() != TRIANGLE || (0..COUNT).any(wide) {
            return unsound("a deviation");
        }
        if !self.misfit.iter().all(|x| (1e-4..=0.5).contains(x)) {
            return unsound("the misfit");
        }
        if !self.shape().is_likely() {
            return unsound("its shape");
        }
        let rises = |[low, high]: [f64; 2], range: &std::ops::RangeInclusive<f64>| {
            range.contains(&low) && range.contains(&high) && low <= high
        };
        if !rises(self.seen.f_sw_hz, &FREQUENCIES_HZ) || !rises(self.seen.i_a, &CURRENTS_A) {
            return unsound("what it was seen at");
        }
        Ok(())
    }

    /// Shape beside the physics, and the range in which it was measured.
    pub(crate) fn shape(&self) -> ShapeState {
        let range = Range {
            f_sw_hz: self.seen.f_sw_hz,
            i_a: self.seen.i_a,
            misfit: self.misfit,
        };
        ShapeState {
            codes: self.shape.clone(),
            range,
        }
    }

    /// Row of the factor, up to its diagonal.
    fn row(&self, row: usize) -> &[f64] {
        &self.factor[row * (row + 1) / 2..][..=row]
    }

    pub(super) fn numbers(&self) -> Vector3<f64> {
        let all = parameters::raw(&self.model);
        Vector3::from_fn(|k, _| all[k])
    }

    /// Covariance of α, s and radius.
    pub(super) fn covariance(&self) -> Matrix3<f64> {
        let l = Matrix3::from_fn(|row, k| if k <= row { self.row(row)[k] } else { 0.0 });
        l * l.transpose()
    }
}

impl MeasuredRange {
    pub(super) fn and(&self, other: &Self) -> Self {
        let wider = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self {
            f_sw_hz: wider(self.f_sw_hz, other.f_sw_hz),
            i_a: wider(self.i_a, other.i_a),
            curves: self.curves.saturating_add(other.curves),
            windows: self.windows.saturating_add(other.windows),
        }
    }
}

fn is_name(name: &str) -> bool {
    let letter = |c: u8| c.is_ascii_alphanumeric() || b"-_.+".contains(&c);
    (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(letter)
}

fn is_label(label: &str) -> bool {
    label.len() <= MAX_NAME && !label.chars().any(char::is_control)
}
