//! Keys of a site: one file for each seed, readable by its owner only.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use ihd_daemon::private_file::{create_private, mode_open_to_others};
use nkeys::{KeyPair, KeyPairType};

/// Extension of a seed file.
const SUFFIX: &str = "nk";

/// Largest seed file in bytes; a seed has 58 characters.
const MAX_FILE_BYTES: u64 = 1024;

/// Error of a key; the message advises.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// File that cannot be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Not a user's seed.
    #[error(
        "{}: this is no NKey of a user (58 characters that begin with SU); remove the file, and `ihd-fleet init server-config` \
         makes a new one",
        path.display()
    )]
    NoSeed {
        /// The file.
        path: PathBuf,
    },
    /// File that others than its owner may read.
    #[error("{}: others may read it (mode {mode:o}): `chmod 600` it, and replace its secret if it may have been seen", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// Its mode.
        mode: u32,
    },
    /// No random numbers from the operating system.
    #[error("no key can be made: {0}")]
    Random(nkeys::error::Error),
}

/// Key pair: the seed authenticates its owner, the server has the public half.
#[derive(Clone, PartialEq, Eq)]
pub struct UserKey {
    seed: String,
    public: String,
}

impl UserKey {
    /// Makes a new key.
    ///
    /// # Errors
    /// [`KeyError::Random`].
    pub fn make() -> Result<Self, KeyError> {
        let pair = KeyPair::new_user();
        Ok(Self {
            seed: pair.seed().map_err(KeyError::Random)?,
            public: pair.public_key(),
        })
    }

    /// Reads a key from its owner's file.
    ///
    /// # Errors
    /// [`KeyError`] if the file is missing, not a seed, or readable by others.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let io = |source| KeyError::Io {
            path: path.into(),
            source,
        };
        let file = File::open(path).map_err(io)?;
        refuse_if_open_to_others(&file, path)?;
        let mut text = String::new();
        let no_seed = || KeyError::NoSeed { path: path.into() };
        let read = file.take(MAX_FILE_BYTES).read_to_string(&mut text);
        read.map_err(|why| match why.kind() {
            io::ErrorKind::InvalidData => no_seed(),
            _ => io(why),
        })?;
        let seed = text.trim().to_owned();
        let pair = KeyPair::from_seed(&seed).map_err(|_| no_seed())?;
        if pair.key_pair_type() != KeyPairType::User {
            return Err(no_seed());
        }
        let public = pair.public_key();
        Ok(Self { seed, public })
    }

    /// Returns the secret seed, `SU…`.
    pub fn seed(&self) -> &str {
        &self.seed
    }

    /// Returns the public key, `U…`.
    pub fn public(&self) -> &str {
        &self.public
    }
}

/// Without the seed, because this may be logged.
impl std::fmt::Debug for UserKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Key({})", self.public)
    }
}

/// Returns the keys `names` of `folder`; missing ones are made, in files `NAME.nk`.
///
/// # Errors
/// [`KeyError`] of the first unusable file; keys made before it stay.
pub fn read_or_make<'a>(
    folder: &Path,
    names: impl IntoIterator<Item = &'a str>,
) -> Result<BTreeMap<String, UserKey>, KeyError> {
    make_folder(folder).map_err(|source| KeyError::Io {
        path: folder.into(),
        source,
    })?;
    let key = |name: &str| {
        let path = folder.join(format!("{name}.{SUFFIX}"));
        let key = if path.exists() {
            UserKey::read(&path)?
        } else {
            let key = UserKey::make()?;
            let write = write_new(&path, key.seed());
            write.map_err(|source| KeyError::Io { path, source })?;
            key
        };
        Ok((name.to_owned(), key))
    };
    names.into_iter().map(key).collect()
}

fn make_folder(folder: &Path) -> io::Result<()> {
    let mut builder = fs::DirBuilder::new();
    builder.recursive(true);
    #[cfg(unix)]
    std::os::unix::fs::DirBuilderExt::mode(&mut builder, 0o700);
    builder.create(folder)
}

/// Writes a new file for its owner alone.
fn write_new(path: &Path, seed: &str) -> io::Result<()> {
    let mut file = create_private(path)?;
    writeln!(file, "{seed}")?;
    file.sync_all()
}

/// Refuses a file that others than its owner may read.
///
/// # Errors
/// [`KeyError::Open`].
pub(crate) fn refuse_if_open_to_others(file: &File, path: &Path) -> Result<(), KeyError> {
    let open = mode_open_to_others(file).map_err(|source| KeyError::Io {
        path: path.into(),
        source,
    })?;
    match open {
        Some(mode) => Err(KeyError::Open {
            path: path.into(),
            mode,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_made_once_and_differ() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("keys");
        let first = read_or_make(&folder, ["a", "b"]).unwrap();
        assert_ne!(first["a"], first["b"]);
        assert!(first["a"].seed().starts_with("SU") && first["a"].seed().len() == 58);
        assert!(first["a"].public().starts_with('U') && first["a"].public().len() == 56);
        let again = read_or_make(&folder, ["a", "b", "c"]).unwrap();
        assert_eq!((&again["a"], &again["b"]), (&first["a"], &first["b"]));
        // "SU" alone stands in every sixth list of three public keys, too.
        let shown = format!("{again:?}");
        assert!(again.values().all(|key| !shown.contains(key.seed())));
        assert!(!shown.contains("(SU") && !shown.contains("\"SU"), "{shown}");
    }

    #[cfg(unix)]
    #[test]
    fn seeds_are_for_their_owner_alone() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path().join("keys");
        read_or_make(&folder, ["a"]).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        let file = folder.join("a.nk");
        assert_eq!((mode(&folder), mode(&file)), (0o700, 0o600));
        fs::set_permissions(&file, fs::Permissions::from_mode(0o644)).unwrap();
        let refused = read_or_make(&folder, ["a"]).unwrap_err();
        assert!(matches!(refused, KeyError::Open { mode: 0o644, .. }));
    }

    #[test]
    fn what_is_no_seed_is_refused_and_stays() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.nk");
        let account = KeyPair::new_account().seed().unwrap();
        let user = UserKey::make().unwrap();
        let mut flipped = user.seed().to_owned();
        flipped.replace_range(20..21, if &flipped[20..21] == "A" { "B" } else { "A" });
        for text in ["", "hello", user.public(), &account, &flipped, "\0\0"] {
            write_new(&file, text).unwrap();
            let refused = read_or_make(folder.path(), ["a"]).unwrap_err();
            assert!(matches!(refused, KeyError::NoSeed { .. }), "{text}");
            assert_eq!(fs::read_to_string(&file).unwrap(), format!("{text}\n"));
            fs::remove_file(&file).unwrap();
        }
    }
}
