//! What a service manager and a terminal say to the daemon, and what it says to them.

use std::io;

use ihd_daemon::Daemon;

/// Signals that ask for an end.
pub struct Signals {
    #[cfg(unix)]
    all: [(&'static str, tokio::signal::unix::Signal); 3],
}

impl Signals {
    /// Catches them from now on.
    ///
    /// # Errors
    /// When the system does not let them be caught.
    #[cfg(unix)]
    pub fn new() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            all: [
                ("SIGINT", signal(SignalKind::interrupt())?),
                ("SIGTERM", signal(SignalKind::terminate())?),
                // A terminal that is closed.
                ("SIGHUP", signal(SignalKind::hangup())?),
            ],
        })
    }

    /// The next one.
    #[cfg(unix)]
    pub async fn next(&mut self) -> &'static str {
        let [(int, a), (term, b), (hup, c)] = &mut self.all;
        tokio::select! {
            _ = a.recv() => int,
            _ = b.recv() => term,
            _ = c.recv() => hup,
        }
    }

    /// Catches them from now on.
    ///
    /// # Errors
    /// Never here: each wait catches them anew.
    #[cfg(not(unix))]
    pub fn new() -> io::Result<Self> {
        Ok(Self {})
    }

    /// The next one.
    #[cfg(not(unix))]
    pub async fn next(&mut self) -> &'static str {
        match tokio::signal::ctrl_c().await {
            Ok(()) => "^C",
            // Nothing can be caught: it ends with the process.
            Err(_) => std::future::pending().await,
        }
    }
}

/// Tells systemd that the daemon is there, and then, as often as it wants to hear, that it is alive: its threads run, and
/// its store answers. A disk that is full is no death.
#[cfg(target_os = "linux")]
pub async fn ready_and_alive(daemon: Daemon) {
    use sd_notify::NotifyState;
    tell(NotifyState::Ready);
    let Some(within) = sd_notify::watchdog_enabled() else {
        return;
    };
    loop {
        if ihd_api::daemon_backend::store_answers(&daemon).await {
            tell(NotifyState::Watchdog);
        } else {
            tracing::error!("the store does not answer: the watchdog is not told that all is well");
        }
        tokio::time::sleep(within / 3).await;
    }
}

/// Nobody to tell.
#[cfg(not(target_os = "linux"))]
pub async fn ready_and_alive(_: Daemon) {}

/// Tells systemd that the daemon ends.
pub fn stopping() {
    #[cfg(target_os = "linux")]
    tell(sd_notify::NotifyState::Stopping);
}

#[cfg(target_os = "linux")]
fn tell(state: sd_notify::NotifyState<'_>) {
    // Without NOTIFY_SOCKET there is nobody, and that is no error.
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "systemd");
    }
}
