//! Sessions of browsers that showed a token: each has a key of its own, which is good for nothing once the session or the daemon has ended.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use subtle::ConstantTimeEq;
use tokio::time::Instant;

use super::Role;
use super::tokens::{TokenError, random_token};

/// Life of a session that nobody uses.
pub(crate) const LASTS: Duration = Duration::from_secs(12 * 3600);

/// Sessions at a time; one more ends the one that was used longest ago.
const MOST: usize = 256;

struct Session {
    key: String,
    role: Role,
    used: Instant,
}

/// All sessions, in memory alone. Their keys appear in no message.
#[derive(Default)]
pub(crate) struct Sessions(Mutex<Vec<Session>>);

impl Sessions {
    /// Those that have not ended.
    fn lock(&self) -> MutexGuard<'_, Vec<Session>> {
        // Every change is complete in itself.
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Instant::now();
        sessions.retain(|session| now.saturating_duration_since(session.used) < LASTS);
        sessions
    }

    /// Begins a session of this role; returns its key.
    ///
    /// # Errors
    /// [`TokenError::Random`].
    pub(crate) fn open(&self, role: Role) -> Result<String, TokenError> {
        let key = random_token()?;
        let mut sessions = self.lock();
        if sessions.len() >= MOST {
            let by_use = sessions.iter().enumerate();
            let oldest = by_use
                .min_by_key(|(_, session)| session.used)
                .map(|(k, _)| k);
            oldest.map(|k| sessions.swap_remove(k));
        }
        sessions.push(Session {
            key: key.clone(),
            role,
            used: Instant::now(),
        });
        Ok(key)
    }

    /// The role of a session, which lasts anew from now on.
    pub(crate) fn role(&self, key: &str) -> Option<Role> {
        let mut sessions = self.lock();
        let found = sessions
            .iter_mut()
            .find(|session| is_same(&session.key, key))?;
        found.used = Instant::now();
        Some(found.role)
    }

    /// Ends a session.
    pub(crate) fn close(&self, key: &str) {
        self.lock().retain(|session| !is_same(&session.key, key));
    }
}

/// Takes as long for a wrong key as for a right one.
fn is_same(key: &str, given: &str) -> bool {
    key.as_bytes().ct_eq(given.as_bytes()).into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_session_ends_when_nobody_has_used_it_for_its_time_or_when_it_is_closed() {
        let sessions = Sessions::default();
        let used = sessions.open(Role::Operate).unwrap();
        let idle = sessions.open(Role::Read).unwrap();
        let closed = sessions.open(Role::Read).unwrap();
        assert!(used != idle && used.len() == 64);
        assert_eq!(sessions.role(&closed), Some(Role::Read));
        sessions.close(&closed);
        assert_eq!(sessions.role(&closed), None);
        let nearly = LASTS - Duration::from_secs(1);
        for _ in 0..3 {
            tokio::time::advance(nearly).await;
            assert_eq!(sessions.role(&used), Some(Role::Operate));
        }
        assert_eq!(sessions.role(&idle), None);
        tokio::time::advance(LASTS).await;
        assert_eq!(sessions.role(&used), None);
        assert_eq!(sessions.role(""), None);
    }

    #[tokio::test(start_paused = true)]
    async fn too_many_end_the_one_that_was_used_longest_ago() {
        let sessions = Sessions::default();
        let mut keys = Vec::new();
        for _ in 0..MOST {
            keys.push(sessions.open(Role::Read).unwrap());
            tokio::time::advance(Duration::from_secs(1)).await;
        }
        assert!(sessions.role(&keys[0]).is_some());
        let one_more = sessions.open(Role::Read).unwrap();
        assert_eq!(sessions.role(&keys[1]), None);
        for key in [&keys[0], &keys[2], &one_more] {
            assert!(sessions.role(key).is_some());
        }
    }
}
