//! Token file: one line `role token` per token, readable by its owner only.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use ihd_daemon::private_file::{create_private, mode_open_to_others};
use ihd_model::Role;
use rustls::crypto::ring;
use subtle::{Choice, ConditionallySelectable, ConstantTimeEq};
use thiserror::Error;

/// Random bytes of a generated token, which is written in hexadecimal.
const TOKEN_BYTES: usize = 32;

/// Minimum length of a token in the file, in characters.
const MIN_CHARACTERS: usize = 32;

/// Maximum number of bytes read from a token file.
const MAX_FILE_BYTES: u64 = 65_536;

/// Error of a token file.
#[derive(Debug, Error)]
pub enum TokenError {
    /// It cannot be created or read, or its permissions cannot be read.
    #[error("token file {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// Other users may read it.
    #[error(
        "token file {} can be read by others than its owner (mode {mode:03o}): \
         run `chmod 600` on it, and replace its tokens if they may have been seen",
        path.display()
    )]
    Open {
        /// The file.
        path: PathBuf,
        /// Permission bits.
        mode: u32,
    },
    /// A line is not `role token`.
    #[error("token file {}, line {line}: {why}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// Error in the line.
        why: &'static str,
    },
    /// It contains no token.
    #[error("token file {} holds no token: delete it, and a new one is made", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// The system has no random numbers.
    #[error("no random numbers for a token")]
    Random,
}

/// Valid tokens with their roles. They appear in no message.
pub struct Tokens(Vec<(Role, String)>);

impl Tokens {
    /// Reads the token file, or creates it with a token of each role if it is missing. The second value is `true` if it was created.
    ///
    /// # Errors
    /// [`TokenError`]; no token of a rejected file is used.
    pub fn read_or_create(path: &Path) -> Result<(Self, bool), TokenError> {
        match Self::create(path) {
            Ok(tokens) => Ok((tokens, true)),
            Err(TokenError::Io { source, .. }) if source.kind() == io::ErrorKind::AlreadyExists => {
                Ok((Self::read(path)?, false))
            }
            Err(error) => Err(error),
        }
    }

    /// Reads the token file.
    ///
    /// # Errors
    /// As [`Tokens::read_or_create`].
    pub fn read(path: &Path) -> Result<Self, TokenError> {
        let io = |source| TokenError::Io {
            path: path.into(),
            source,
        };
        let mut file = fs::File::open(path).map_err(io)?;
        // Checks the open file: the path may name another one by now.
        refuse_if_open_to_others(&file, path)?;
        let mut text = String::new();
        io::Read::read_to_string(&mut io::Read::take(&mut file, MAX_FILE_BYTES), &mut text)
            .map_err(io)?;
        Self::parse(&text, path)
    }

    fn create(path: &Path) -> Result<Self, TokenError> {
        let io = |source| TokenError::Io {
            path: path.into(),
            source,
        };
        let mut file = create_private(path).map_err(io)?;
        let mut tokens = Vec::new();
        let mut text =
            String::from("# Tokens of ihd's API: `role token`. Whoever has one has its role.\n");
        for role in Role::ALL {
            let token = random_token()?;
            text += &format!("{} {token}\n", role.name());
            tokens.push((role, token));
        }
        file.write_all(text.as_bytes()).map_err(io)?;
        file.sync_all().map_err(io)?;
        Ok(Self(tokens))
    }

    fn parse(text: &str, path: &Path) -> Result<Self, TokenError> {
        let mut tokens = Vec::new();
        for (k, line) in text.lines().enumerate() {
            let wrong = |why| TokenError::Line {
                path: path.into(),
                line: k + 1,
                why,
            };
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let (role, token) = line
                .split_once(char::is_whitespace)
                .ok_or_else(|| wrong("it is not `role token`"))?;
            let role = Role::from_name(role)
                .ok_or_else(|| wrong("the role is neither read nor operate: delete the line"))?;
            let token = token.trim();
            if token.len() < MIN_CHARACTERS {
                return Err(wrong("the token is shorter than 32 characters"));
            }
            if !token.bytes().all(|b| b.is_ascii_graphic()) {
                return Err(wrong("the token holds other than printable ASCII"));
            }
            tokens.push((role, token.to_owned()));
        }
        if tokens.is_empty() {
            return Err(TokenError::Empty { path: path.into() });
        }
        Ok(Self(tokens))
    }

    /// Returns the highest role of a token; `None` if it is not valid. Takes the same time for all tokens of a length.
    pub fn role(&self, given: &str) -> Option<Role> {
        // 0 is no role; selected without a branch.
        let mut highest = 0u8;
        for (role, token) in &self.0 {
            let same: Choice = token.as_bytes().ct_eq(given.as_bytes());
            let higher = highest.max(*role as u8 + 1);
            highest = u8::conditional_select(&highest, &higher, same);
        }
        Role::ALL.get(usize::from(highest).wrapping_sub(1)).copied()
    }

    /// Returns the token of the lowest sufficient role, for a client that owns the file; `None` if there is none.
    pub fn at_least(&self, role: Role) -> Option<&str> {
        self.0
            .iter()
            .filter(|(has, _)| *has >= role)
            .min_by_key(|(has, _)| *has)
            .map(|(_, token)| token.as_str())
    }
}

/// Returns a new random token.
pub(crate) fn random_token() -> Result<String, TokenError> {
    let mut bytes = [0; TOKEN_BYTES];
    ring::default_provider()
        .secure_random
        .fill(&mut bytes)
        .map_err(|_| TokenError::Random)?;
    Ok(bytes.iter().map(|b| format!("{b:02x}")).collect())
}

fn refuse_if_open_to_others(file: &fs::File, path: &Path) -> Result<(), TokenError> {
    let open = mode_open_to_others(file).map_err(|source| TokenError::Io {
        path: path.into(),
        source,
    })?;
    match open {
        Some(mode) => Err(TokenError::Open {
            path: path.into(),
            mode,
        }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Tokens, TokenError> {
        Tokens::parse(text, Path::new("tokens"))
    }

    #[test]
    fn a_file_that_is_made_holds_a_different_token_of_each_role_for_its_owner_alone() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("tokens");
        let (made, new) = Tokens::read_or_create(&path).unwrap();
        assert!(new);
        for (role, token) in &made.0 {
            assert_eq!(token.len(), 64);
            assert_eq!(made.role(token), Some(*role));
        }
        assert_ne!(made.0[0].1, made.0[1].1);
        let (read, new) = Tokens::read_or_create(&path).unwrap();
        assert!(!new);
        assert_eq!(read.0, made.0);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = |mode| fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
            assert_eq!(
                fs::metadata(&path).unwrap().permissions().mode() & 0o777,
                0o600
            );
            for open in [0o640, 0o604, 0o620] {
                mode(open);
                let refused = Tokens::read_or_create(&path).err().unwrap().to_string();
                assert!(refused.contains("chmod 600"), "{refused}");
            }
        }
    }

    #[test]
    fn wrong_tokens_have_no_role() {
        let right = "a".repeat(64);
        let tokens = parsed(&format!("operate {right}\n")).unwrap();
        assert_eq!(tokens.role(&right), Some(Role::Operate));
        for wrong in ["", "a", &right[1..], &format!("{right}a"), &"b".repeat(64)] {
            assert_eq!(tokens.role(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn lines_that_are_wrong_are_named() {
        let long = "x".repeat(40);
        for (text, word) in [
            ("# only a comment\n".to_owned(), "no token"),
            ("read short\n".to_owned(), "line 1"),
            (format!("\nroot {long}\n"), "line 2"),
            (format!("{long}\n"), "role token"),
            (format!("read {long} {long}\n"), "printable"),
        ] {
            let error = parsed(&text).err().unwrap().to_string();
            assert!(error.contains(word), "{text:?}: {error}");
            assert!(!error.contains(&long), "a token in a message: {error}");
        }
    }

    #[test]
    fn the_owner_gets_the_lowest_token_that_does() {
        let (low, high) = ("l".repeat(32), "h".repeat(32));
        let tokens = parsed(&format!("operate {high}\nread {low}\n")).unwrap();
        assert_eq!(tokens.at_least(Role::Read), Some(low.as_str()));
        assert_eq!(tokens.at_least(Role::Operate), Some(high.as_str()));
        let reader = parsed(&format!("read {low}\n")).unwrap();
        assert_eq!(reader.at_least(Role::Operate), None);
    }
}
