//! Pots that hobs know, for hobs that see one of them for the first time.
//!
//! ```text
//! hob 1: PotMap ─► PotEntry ─► Library ─► hob 2: PotMap, whose first fit begins with that pot
//!        pot_map.rs entry.rs    here             hypotheses.rs
//! ```
//!
//! α, s and radius are the pot's and go with it; lift and offset are where it stands, turns and winding the coil: each hob finds
//! those anew. An entry comes from another machine and may be wrong or a lie. It is never more than one hypothesis beside
//! "none of them", which keeps a share however well an entry fits ([`crate::PotMap::with_library`]).

mod entry;
mod shape;
#[cfg(test)]
mod tests;
mod transfer;

use serde::{Deserialize, Serialize};

use crate::fit::{Datum, fit};
use crate::parameters::{CENTRED, COUNT, Prior};

pub(crate) use entry::Found;

pub use shape::places as shape_places;
pub(crate) use shape::{KeptShape, Shape};

pub use entry::{ENTRY_VERSION, MOST_ENTRY_BYTES, MetalClass, PotEntry, Provenance, SeenAt};

/// The layout of [`Library::to_bytes`].
pub const LIBRARY_VERSION: u32 = 1;

/// Entries of a library at most: a pot is looked for among all of them in a tenth of a second.
pub const MOST_ENTRIES: usize = 128;

/// Of these that rest on one hob alone: one that sends many makes room among its own.
pub const MOST_OF_ONE_HOB: usize = 16;

/// Why bytes are no entry or no library.
#[derive(Debug, thiserror::Error)]
pub enum LibraryError {
    /// More than there can be.
    #[error("{bytes} bytes are more than the {most} that a pot or a library can have")]
    TooLarge {
        /// How many.
        bytes: usize,
        /// How many there may be.
        most: usize,
    },
    /// No JSON of this layout.
    #[error("a pot of the library cannot be read: {0}")]
    Json(#[from] serde_json::Error),
    /// Of another build.
    #[error(
        "a pot of the library has layout {0}, this build reads layout {ENTRY_VERSION}: bring both hobs to one build"
    )]
    Version(u32),
    /// No hob can have found it.
    #[error("a pot of the library is refused: no hob can have found {0} like this")]
    Unsound(&'static str),
}

/// What became of an entry.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Added {
    /// A pot that was not known.
    New,
    /// The entry of this name knows the pot better now.
    Merged(String),
    /// The entry of this name knew the pot from this hob already; where it rests on that hob alone, the newer one counts.
    Again(String),
}

/// Pots that hobs know.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Library {
    entries: Vec<PotEntry>,
}

#[derive(Serialize, Deserialize)]
struct Saved {
    version: u32,
    entries: Vec<PotEntry>,
}

impl Library {
    /// The pots.
    pub fn entries(&self) -> &[PotEntry] {
        &self.entries
    }

    /// Takes an entry in. The same pot seen by another hob is merged; where there is no room, an old one of whoever fills the
    /// library goes.
    ///
    /// # Errors
    /// [`LibraryError`] when no hob can have found it.
    pub fn add(&mut self, entry: PotEntry) -> Result<Added, LibraryError> {
        entry.check()?;
        let nearest = self.entries.iter_mut().find(|e| e.is_same(&entry));
        if let Some(known) = nearest {
            let id = known.id().to_owned();
            let is_new = |hob: &String| !known.hobs().contains(hob);
            if !entry.hobs().iter().all(is_new) {
                if known.hobs().len() == 1 && known.t_unix_s() <= entry.t_unix_s() {
                    *known = entry;
                }
                return Ok(Added::Again(id));
            }
            if known.merge(&entry).is_some() {
                return Ok(Added::Merged(id));
            }
            // As many hobs as an entry names agree on it already.
            return Ok(Added::Again(id));
        }
        self.make_room(&entry.hobs()[0]);
        self.entries.push(entry);
        Ok(Added::New)
    }

    /// Removes what one more entry of this hob has no room beside.
    fn make_room(&mut self, hob: &str) {
        let alone = |e: &PotEntry, hob: &str| e.hobs().len() == 1 && e.hobs()[0] == hob;
        let count = |hob: &str| self.entries.iter().filter(|e| alone(e, hob)).count();
        let fills = if count(hob) >= MOST_OF_ONE_HOB {
            hob.to_owned()
        } else if self.entries.len() >= MOST_ENTRIES {
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

    /// As bytes: JSON.
    pub fn to_bytes(&self) -> Vec<u8> {
        let saved = Saved {
            version: LIBRARY_VERSION,
            entries: self.entries.clone(),
        };
        serde_json::to_vec(&saved).unwrap_or_default()
    }

    /// From bytes that anybody may have made.
    ///
    /// # Errors
    /// [`LibraryError`]; nothing of such bytes is used.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LibraryError> {
        let most = MOST_ENTRIES * MOST_ENTRY_BYTES;
        if bytes.len() > most {
            return Err(LibraryError::TooLarge {
                bytes: bytes.len(),
                most,
            });
        }
        let saved: Saved = serde_json::from_slice(bytes)?;
        if saved.version != LIBRARY_VERSION {
            return Err(LibraryError::Version(saved.version));
        }
        if saved.entries.len() > MOST_ENTRIES {
            return Err(LibraryError::Unsound("so many pots"));
        }
        saved.entries.iter().try_for_each(PotEntry::check)?;
        Ok(Self {
            entries: saved.entries,
        })
    }

    /// Entries that may be the pot that was seen, the likeliest first: the physics of each is laid through a few of the data, with
    /// lift, turns and winding free. That is what an unknown pot is recognised by, whatever the coil and the place.
    pub(crate) fn candidates(&self, data: &[Datum]) -> Vec<Candidate> {
        /// Data that are looked at, of which the first look needs no more.
        const LOOKED_AT: usize = 8;
        const MISFIT: [f64; 2] = [0.016, 0.008];
        const LOOKS: usize = 3;
        /// Candidates that are worth a whole fit.
        const MOST: usize = 3;
        let every = data.len().div_ceil(LOOKED_AT).max(1);
        let few: Vec<Datum> = data.iter().copied().step_by(every).collect();
        let look = |entry: &PotEntry| {
            let candidate = Candidate::of(entry);
            let (few, none) = (candidate.without_shape(&few), [0.0; COUNT]);
            let fitted = fit(&few, (&candidate.prior, none), CENTRED, MISFIT, LOOKS)?;
            // Four times the squares that chance makes: lift and place may still be off.
            (fitted.cost < 4.0 * few.len() as f64).then_some((fitted.cost, candidate))
        };
        let mut likely: Vec<_> = self.entries.iter().filter_map(look).collect();
        likely.sort_by(|a, b| a.0.total_cmp(&b.0));
        likely.truncate(MOST);
        likely.into_iter().map(|(_, candidate)| candidate).collect()
    }
}

/// An entry as a hypothesis.
#[derive(Clone, Debug)]
pub(crate) struct Candidate {
    pub id: String,
    pub prior: Prior,
    pub shape: Shape,
}

impl Candidate {
    fn of(entry: &PotEntry) -> Self {
        Self {
            id: entry.id().to_owned(),
            prior: entry.prior(),
            shape: Shape::of(entry.shape()),
        }
    }

    /// What the physics alone would have shown.
    pub fn without_shape(&self, data: &[Datum]) -> Vec<Datum> {
        without(&self.shape, data)
    }
}

/// Data less a shape.
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
