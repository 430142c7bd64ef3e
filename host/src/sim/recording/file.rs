//! Recordings on disk: safetensors (<https://github.com/huggingface/safetensors>), readable with
//! one package from Python, Julia and others. `docs/simulator.md` lists the tensors.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde::{Deserialize, Serialize};

use super::run::Recording;
use super::sensing::Rate;
use super::settings::Settings;
use crate::sim::inverter::meter::{ORDERS, PeriodTruth};

/// Key of the one metadata entry, a JSON object.
const METADATA_KEY: &str = "ihd-recording";

/// Version of the tensors' names and meanings.
const VERSION: u32 = 1;

/// Why a recording could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a safetensors file, or a damaged one.
    #[error("{path} is no readable safetensors file: {source}")]
    Container {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        source: safetensors::SafeTensorError,
    },
    /// A safetensors file of another kind.
    #[error("{path} is no recording of `ihd simulate`: {what}")]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// What is missing or different.
        what: String,
    },
}

/// The metadata entry.
#[derive(Serialize, Deserialize)]
struct Metadata {
    version: u32,
    made_by: String,
    volt_per_code: f64,
    ampere_per_code: f64,
    harmonic_orders: Vec<usize>,
    settings: Settings,
}

/// Columns of the truth: one f64 a period.
type Column = (&'static str, fn(&PeriodTruth) -> f64);
const SCALARS: [Column; 5] = [
    ("truth_t_s", |t| t.t_s),
    ("truth_f_sw_hz", |t| t.f_sw_hz),
    ("truth_i_a", |t| t.i_a),
    ("truth_r_power_ohm", |t| t.r_power_ohm),
    ("truth_p_w", |t| t.p_w),
];

fn bytes<const B: usize>(values: impl Iterator<Item = [u8; B]>) -> Vec<u8> {
    values.flatten().collect()
}

/// Writes a recording; `clean` adds the waveforms without noise and quantising.
pub fn write(recording: &Recording, path: &Path, clean: bool) -> Result<(), FileError> {
    let mut columns: Vec<(&str, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
    let samples = vec![recording.v_code.len()];
    let codes = |c: &[i16]| bytes(c.iter().map(|c| c.to_le_bytes()));
    columns.push((
        "v_code",
        Dtype::I16,
        samples.clone(),
        codes(&recording.v_code),
    ));
    columns.push((
        "i_code",
        Dtype::I16,
        samples.clone(),
        codes(&recording.i_code),
    ));
    if recording.settings.sensing.rate == Rate::Locked {
        let t = bytes(recording.t_s.iter().map(|t| t.to_le_bytes()));
        columns.push(("t_s", Dtype::F64, samples.clone(), t));
    }
    if clean {
        let single = |x: &[f64]| bytes(x.iter().map(|x| (*x as f32).to_le_bytes()));
        columns.push((
            "v_clean_v",
            Dtype::F32,
            samples.clone(),
            single(&recording.v_clean_v),
        ));
        columns.push((
            "i_clean_a",
            Dtype::F32,
            samples,
            single(&recording.i_clean_a),
        ));
    }
    let truth = &recording.truth;
    for (name, value) in SCALARS {
        let data = bytes(truth.iter().map(|t| value(t).to_le_bytes()));
        columns.push((name, Dtype::F64, vec![truth.len()], data));
    }
    let orders = vec![truth.len(), ORDERS.len()];
    let r = bytes(truth.iter().flat_map(|t| t.r_ohm).map(f64::to_le_bytes));
    let l = bytes(truth.iter().flat_map(|t| t.l_h).map(f64::to_le_bytes));
    columns.push(("truth_r_ohm", Dtype::F64, orders.clone(), r));
    columns.push(("truth_l_h", Dtype::F64, orders, l));

    let metadata = Metadata {
        version: VERSION,
        made_by: concat!("ihd ", env!("CARGO_PKG_VERSION")).to_owned(),
        volt_per_code: recording.volt_per_code(),
        ampere_per_code: recording.ampere_per_code(),
        harmonic_orders: ORDERS.to_vec(),
        settings: recording.settings.clone(),
    };
    let foreign = |e: serde_json::Error| FileError::Foreign {
        path: path.to_owned(),
        what: e.to_string(),
    };
    let text = serde_json::to_string(&metadata).map_err(foreign)?;
    let container = |source| FileError::Container {
        path: path.to_owned(),
        source,
    };
    let mut views = Vec::with_capacity(columns.len());
    for (name, dtype, shape, data) in &columns {
        let view = TensorView::new(*dtype, shape.clone(), data).map_err(container)?;
        views.push((*name, view));
    }
    let entry = HashMap::from([(METADATA_KEY.to_owned(), text)]);
    let encoded = safetensors::serialize(views, Some(entry)).map_err(container)?;
    std::fs::write(path, encoded).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })
}

/// What [`read`] gives back.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    /// Settings of the simulation.
    pub settings: Settings,
    /// Sampling instants in seconds; computed from the rate where it is fixed.
    pub t_s: Vec<f64>,
    /// Voltage in volt, from the codes.
    pub v_v: Vec<f64>,
    /// Current in ampere, from the codes.
    pub i_a: Vec<f64>,
    /// Truth by tensor name (`truth_…`), row by row.
    pub truth: HashMap<String, Vec<f64>>,
}

/// Reads a recording back.
pub fn read(path: &Path) -> Result<Stored, FileError> {
    let data = std::fs::read(path).map_err(|source| FileError::Io {
        path: path.to_owned(),
        source,
    })?;
    let container = |source| FileError::Container {
        path: path.to_owned(),
        source,
    };
    let foreign = |what: String| FileError::Foreign {
        path: path.to_owned(),
        what,
    };
    let (_, header) = SafeTensors::read_metadata(&data).map_err(container)?;
    let text = header.metadata().as_ref().and_then(|m| m.get(METADATA_KEY));
    let text = text.ok_or_else(|| foreign(format!("no {METADATA_KEY} entry")))?;
    let metadata: Metadata = serde_json::from_str(text).map_err(|e| foreign(e.to_string()))?;
    if metadata.version != VERSION {
        return Err(foreign(format!(
            "version {}, this ihd reads {VERSION}",
            metadata.version
        )));
    }
    let tensors = SafeTensors::deserialize(&data).map_err(container)?;
    let doubles = |name: &str| -> Result<Vec<f64>, FileError> {
        let tensor = tensors.tensor(name).map_err(container)?;
        let (chunks, rest) = tensor.data().as_chunks::<8>();
        if tensor.dtype() != Dtype::F64 || !rest.is_empty() {
            return Err(foreign(format!("{name} is not f64")));
        }
        Ok(chunks.iter().map(|b| f64::from_le_bytes(*b)).collect())
    };
    let codes = |name: &str, unit: f64| -> Result<Vec<f64>, FileError> {
        let tensor = tensors.tensor(name).map_err(container)?;
        let (chunks, rest) = tensor.data().as_chunks::<2>();
        if tensor.dtype() != Dtype::I16 || !rest.is_empty() {
            return Err(foreign(format!("{name} is not i16")));
        }
        Ok(chunks
            .iter()
            .map(|b| f64::from(i16::from_le_bytes(*b)) * unit)
            .collect())
    };
    let v_v = codes("v_code", metadata.volt_per_code)?;
    let i_a = codes("i_code", metadata.ampere_per_code)?;
    let t_s = match metadata.settings.sensing.rate {
        Rate::Locked => doubles("t_s")?,
        Rate::Hz(rate_hz) => (0..v_v.len()).map(|k| k as f64 / rate_hz).collect(),
    };
    if v_v.len() != i_a.len() || v_v.len() != t_s.len() {
        return Err(foreign("columns of different length".to_owned()));
    }
    let mut truth = HashMap::new();
    for name in SCALARS
        .map(|(name, _)| name)
        .into_iter()
        .chain(["truth_r_ohm", "truth_l_h"])
    {
        truth.insert(name.to_owned(), doubles(name)?);
    }
    Ok(Stored {
        settings: metadata.settings,
        t_s,
        v_v,
        i_a,
        truth,
    })
}

#[cfg(test)]
mod tests {
    use super::super::run::record;
    use super::super::settings::LoadKind;
    use super::*;

    fn short() -> Recording {
        let mut s = Settings {
            load: LoadKind::Behavioural,
            duration_s: 1e-3,
            ..Settings::default()
        };
        s.sensing.rate = Rate::Locked;
        s.sensing.snr_db = Some(40.0);
        record(&s, |_| ()).unwrap()
    }

    #[test]
    fn what_is_written_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        let r = short();
        write(&r, &path, true).unwrap();
        let back = read(&path).unwrap();
        assert_eq!(back.settings, r.settings);
        assert_eq!(back.t_s, r.t_s);
        assert_eq!(back.v_v[100], f64::from(r.v_code[100]) * r.volt_per_code());
        assert_eq!(back.truth["truth_i_a"].len(), r.truth.len());
        assert_eq!(back.truth["truth_l_h"][4], r.truth[1].l_h[0]);
        let again = dir.path().join("b.safetensors");
        write(&short(), &again, true).unwrap();
        assert_eq!(
            std::fs::read(&path).unwrap(),
            std::fs::read(&again).unwrap()
        );
    }

    #[test]
    fn damaged_and_foreign_files_are_refused_with_their_path() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.safetensors");
        write(&short(), &path, false).unwrap();
        let data = std::fs::read(&path).unwrap();
        for cut in [0, 7, 100, data.len() - 1] {
            std::fs::write(&path, &data[..cut]).unwrap();
            let e = read(&path).unwrap_err().to_string();
            assert!(e.contains("a.safetensors"), "{e}");
        }
        let empty: Vec<(&str, TensorView<'_>)> = Vec::new();
        std::fs::write(&path, safetensors::serialize(empty, None).unwrap()).unwrap();
        assert!(matches!(read(&path), Err(FileError::Foreign { .. })));
    }
}
