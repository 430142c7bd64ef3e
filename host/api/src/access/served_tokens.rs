//! Tokens in use: read again when their file changes, so that one that is taken out of it ends.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use ihd_daemon::locking::lock;
use ihd_model::Role;

use super::tokens::{TokenError, Tokens};
use crate::stamp::{Stamp, stamp};

/// Tokens of a running server.
pub(crate) struct ServedTokens {
    path: PathBuf,
    state: Mutex<State>,
}

struct State {
    tokens: Tokens,
    /// File as last read; `None` if it was missing.
    stamp: Option<Stamp>,
}

impl ServedTokens {
    /// Reads the token file, or creates it. The second value is `true` if it was created.
    ///
    /// # Errors
    /// As [`Tokens::read_or_create`].
    pub(crate) fn load(path: &Path) -> Result<(Self, bool), TokenError> {
        let before = stamp(path);
        let (tokens, is_new) = Tokens::read_or_create(path)?;
        let state = State {
            tokens,
            stamp: before.or_else(|| stamp(path)),
        };
        let served = Self {
            path: path.to_owned(),
            state: Mutex::new(state),
        };
        Ok((served, is_new))
    }

    /// Reads a changed file; returns `true` if it was read. One that cannot be used leaves the tokens that were read before.
    pub(crate) fn refresh(&self) -> bool {
        let mut state = self.state();
        let now = stamp(&self.path);
        if now.is_none() || now == state.stamp {
            return false;
        }
        state.stamp = now;
        match Tokens::read(&self.path) {
            Ok(tokens) => {
                tracing::info!(file = %self.path.display(), "tokens, read again; sessions have ended");
                state.tokens = tokens;
                true
            }
            Err(error) => {
                tracing::warn!(%error, "the changed token file cannot be used; the tokens before stay valid");
                false
            }
        }
    }

    /// Returns the highest role of a token; `None` if it is not valid.
    pub(crate) fn role(&self, given: &str) -> Option<Role> {
        self.state().tokens.role(given)
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}
