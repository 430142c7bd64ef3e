//! Sessions of browsers that have presented a token. Each has its own key, valid until the session or the daemon ends.

use std::sync::{Mutex, MutexGuard};
use std::time::Duration;

use ihd_daemon::locking::lock;
use ihd_model::Role;
use subtle::ConstantTimeEq;
use tokio::time::Instant;

use super::tokens::{TokenError, random_token};

/// Lifetime of an unused session.
pub(crate) const LIFETIME: Duration = Duration::from_secs(12 * 3600);

/// Maximum number of sessions; one more ends the least recently used one of the lowest role that has any.
const MAX_SESSIONS: usize = 256;

struct Session {
    key: String,
    role: Role,
    used: Instant,
}

/// All sessions, in memory only. Their keys appear in no message.
#[derive(Default)]
pub(crate) struct Sessions(Mutex<Vec<Session>>);

impl Sessions {
    /// Locks the sessions and removes those that have expired.
    fn lock(&self) -> MutexGuard<'_, Vec<Session>> {
        let mut sessions = lock(&self.0);
        let now = Instant::now();
        sessions.retain(|session| now.saturating_duration_since(session.used) < LIFETIME);
        sessions
    }

    /// Opens a session of this role and returns its key.
    ///
    /// # Errors
    /// [`TokenError::Random`] if the system has no random numbers.
    pub(crate) fn open(&self, role: Role) -> Result<String, TokenError> {
        let key = random_token()?;
        let mut sessions = self.lock();
        if sessions.len() >= MAX_SESSIONS {
            // Whoever may only read ends no session of somebody who may switch off.
            let by_rank = sessions.iter().enumerate();
            let oldest = by_rank
                .min_by_key(|(_, session)| (session.role, session.used))
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

    /// Returns the role of a session and restarts its lifetime; `None` if there is no such session.
    pub(crate) fn role(&self, key: &str) -> Option<Role> {
        let mut sessions = self.lock();
        let session = sessions
            .iter_mut()
            .find(|session| is_same(&session.key, key))?;
        session.used = Instant::now();
        Some(session.role)
    }

    /// Ends all sessions.
    pub(crate) fn close_all(&self) {
        self.lock().clear();
    }

    /// Ends a session.
    pub(crate) fn close(&self, key: &str) {
        self.lock().retain(|session| !is_same(&session.key, key));
    }
}

/// Compares in constant time.
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
        let nearly = LIFETIME - Duration::from_secs(1);
        for _ in 0..3 {
            tokio::time::advance(nearly).await;
            assert_eq!(sessions.role(&used), Some(Role::Operate));
        }
        assert_eq!(sessions.role(&idle), None);
        tokio::time::advance(LIFETIME).await;
        assert_eq!(sessions.role(&used), None);
        assert_eq!(sessions.role(""), None);
    }

    #[tokio::test(start_paused = true)]
    async fn too_many_end_the_one_that_was_used_longest_ago() {
        let sessions = Sessions::default();
        let mut keys = Vec::new();
        for _ in 0..MAX_SESSIONS {
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

    #[tokio::test(start_paused = true)]
    async fn readers_end_no_session_of_an_operator() {
        let sessions = Sessions::default();
        let operator = sessions.open(Role::Operate).unwrap();
        for _ in 0..2 * MAX_SESSIONS {
            sessions.open(Role::Read).unwrap();
        }
        assert_eq!(sessions.role(&operator), Some(Role::Operate));
    }
}
