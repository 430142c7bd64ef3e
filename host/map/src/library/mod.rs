//! Library of pots that hobs share, for a hob that sees one of them for the first time.
//!
//! ```text
//! hob 1: PotMap ─► PotEntry ─► Library ─► hob 2: PotMap, whose first fit begins with that pot
//!        pot_map.rs entry.rs    here             hypotheses.rs
//! ```
//!
//! α, s and radius are the pot's own numbers and are shared. Lift and offset depend on its place, turns and winding on the coil:
//! each hob fits those itself. An entry comes from another machine and may be wrong or forged. It is therefore only a
//! hypothesis beside "any pot", which keeps half however well an entry fits ([`crate::PotMap::with_library`]).

mod entry;
mod shape;
#[cfg(test)]
mod tests;
mod transfer;

use serde::{Deserialize, Serialize};

use crate::fit::{Datum, fit};
use crate::parameters::{CENTRED, COUNT, Prior};

pub(crate) use entry::ExportedFit;

pub(crate) use shape::{Shape, ShapeState};
pub use shape::{UNIT as SHAPE_UNIT, places as shape_places};

pub use entry::{ENTRY_VERSION, MAX_ENTRY_BYTES, MeasuredRange, MetalClass, PotEntry, Provenance};

/// Version of the layout of [`Library::to_bytes`].
pub const LIBRARY_VERSION: u32 = 1;

/// Most entries of a library: searching all of them takes a tenth of a second.
pub const MAX_ENTRIES: usize = 128;

/// Most entries of one hob alone: a hob that sends many displaces its own.
pub const MAX_OF_ONE_HOB: usize = 16;

/// Reason why bytes are no entry or no library.
#[derive(Debug, thiserror::Error)]
pub enum LibraryError {
    /// Larger than allowed.
    #[error("{bytes} bytes are more than the {most} that a pot or a library can have")]
    TooLarge {
        /// Size in bytes.
        bytes: usize,
        /// Largest size in bytes.
        most: usize,
    },
    /// Not JSON of this layout.
    #[error("a pot of the library cannot be read: {0}")]
    Json(#[from] serde_json::Error),
    /// Layout of another build.
    #[error(
        "a pot of the library has layout {0}, this build reads layout {ENTRY_VERSION}: bring both hobs to one build"
    )]
    Version(u32),
    /// A number that no hob can have found.
    #[error("a pot of the library is refused: no hob can have found {0} like this")]
    Unsound(&'static str),
}

/// Result of adding an entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Addition {
    /// The pot was not in the library.
    New,
    /// The pot was known under this name; the entry was improved.
    Merged(String),
    /// The pot was known under this name from this hob; an entry of that hob alone is replaced by the newer one.
    Repeated(String),
}

/// Set of pots that hobs share.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Library {
    entries: Vec<PotEntry>,
}

#[derive(Serialize, Deserialize)]
struct LibraryFile {
    version: u32,
    entries: Vec<PotEntry>,
}

impl Library {
    /// Entries in the library.
    pub fn entries(&self) -> &[PotEntry] {
        &self.entries
    }

    /// Adds an entry. A pot that another hob measured is merged; in a full library an old entry of the hob with most entries is
    /// removed.
    ///
    /// # Errors
    /// [`LibraryError`] if no hob can have found the entry.
    pub fn add(&mut self, entry: PotEntry) -> Result<Addition, LibraryError> {
        entry.check()?;
        let nearest = self.entries.iter_mut().find(|e| e.is_same(&entry));
        if let Some(known) = nearest {
            let id = known.id().to_owned();
            let is_new = |hob: &String| !known.hobs().contains(hob);
            if !entry.hobs().iter().all(is_new) {
                if known.hobs().len() == 1 && known.t_unix_s() <= entry.t_unix_s() {
                    *known = entry;
                }
                return Ok(Addition::Repeated(id));
            }
            if known.merge(&entry).is_some() {
                return Ok(Addition::Merged(id));
            }
            // As many hobs as an entry names agree on it already.
            return Ok(Addition::Repeated(id));
        }
        self.make_room(&entry.hobs()[0]);
        self.entries.push(entry);
        Ok(Addition::New)
    }

    /// Removes entries so that one more of this hob has room.
    fn make_room(&mut self, hob: &str) {
        let alone = |e: &PotEntry, hob: &str| e.hobs().len() == 1 && e.hobs()[0] == hob;
        let count = |hob: &str| self.entries.iter().filter(|e| alone(e, hob)).count();
        let fills = if count(hob) >= MAX_OF_ONE_HOB {
            hob.to_owned()
        } else if self.entries.len() >= MAX_ENTRIES {
            let most = self.entries.iter().max_by_key(|e| count(&e.hobs()[0]));
            most.map_or_else(String::new, |e| e.hobs()[0].clone())
        } else {
            return;
        };
        let all = self.entries.iter().enumerate();
        let oldest = all
            .filter(|(_, e)| alone(e, &fills) || count(&fills) == 0)
            .min_by_key(|(_, e)| e.t_unix_s())
            .map(|(k, _)| k);
        if let Some(k) = oldest {
            self.entries.remove(k);
        }
    }

    /// Serialises as JSON.
    pub fn to_bytes(&self) -> Vec<u8> {
        let file = LibraryFile {
            version: LIBRARY_VERSION,
            entries: self.entries.clone(),
        };
        serde_json::to_vec(&file).unwrap_or_default()
    }

    /// Reads and checks bytes from an untrusted source.
    ///
    /// # Errors
    /// [`LibraryError`] if the bytes are no library that hobs can have produced.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LibraryError> {
        let most = MAX_ENTRIES * MAX_ENTRY_BYTES;
        if bytes.len() > most {
            return Err(LibraryError::TooLarge {
                bytes: bytes.len(),
                most,
            });
        }
        let file: LibraryFile = serde_json::from_slice(bytes)?;
        if file.version != LIBRARY_VERSION {
            return Err(LibraryError::Version(file.version));
        }
        if file.entries.len() > MAX_ENTRIES {
            return Err(LibraryError::Unsound("so many pots"));
        }
        file.entries.iter().try_for_each(PotEntry::check)?;
        Ok(Self {
            entries: file.entries,
        })
    }

    /// Entries that may be the measured pot, the likeliest first. The physics of each is fitted to a few data with lift, turns and
    /// winding free, so that a pot is recognised on any coil and in any place.
    pub(crate) fn candidates(&self, data: &[Datum]) -> Vec<Candidate> {
        /// Number of data in the first fit, which needs no more.
        const SCREENING_DATA: usize = 8;
        const MISFIT: [f64; 2] = [0.016, 0.008];
        const SCREENING_STEPS: usize = 3;
        /// Most candidates that get a complete fit.
        const MAX_FITTED: usize = 3;
        let every = data.len().div_ceil(SCREENING_DATA).max(1);
        let few: Vec<Datum> = data.iter().copied().step_by(every).collect();
        let screen = |entry: &PotEntry| {
            let candidate = Candidate::from_entry(entry);
            let (few, none) = (candidate.without_shape(&few), [0.0; COUNT]);
            let fitted = fit(
                &few,
                (&candidate.prior, none),
                CENTRED,
                MISFIT,
                SCREENING_STEPS,
            )?;
            // Four times the squares that chance makes: lift and place may still be off.
            (fitted.cost < 4.0 * few.len() as f64).then_some((fitted.cost, candidate))
        };
        let mut likely: Vec<_> = self.entries.iter().filter_map(screen).collect();
        likely.sort_by(|a, b| a.0.total_cmp(&b.0));
        likely.truncate(MAX_FITTED);
        likely.into_iter().map(|(_, candidate)| candidate).collect()
    }
}

/// Entry as a hypothesis.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub id: String,
    pub prior: Prior,
    pub shape: Shape,
}

impl Candidate {
    fn from_entry(entry: &PotEntry) -> Self {
        Self {
            id: entry.id().to_owned(),
            prior: entry.prior(),
            shape: Shape::from_state(entry.shape()),
        }
    }

    /// Data that the physics alone would have given.
    pub fn without_shape(&self, data: &[Datum]) -> Vec<Datum> {
        without(&self.shape, data)
    }
}

/// Subtracts a shape from data.
pub(crate) fn without(shape: &Shape, data: &[Datum]) -> Vec<Datum> {
    let less = |datum: &Datum| {
        let beside = shape.at(datum.f_hz, datum.i_a);
        Datum {
            ln: [0, 1].map(|x| datum.ln[x] - beside[x]),
            ..*datum
        }
    };
    data.iter().map(less).collect()
}
