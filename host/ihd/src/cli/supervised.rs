//! Communication of the daemon with a service manager and a terminal.

use std::io;

use ihd_daemon::Daemon;

/// Signals that request an end.
pub struct Signals {
    #[cfg(unix)]
    all: [(&'static str, tokio::signal::unix::Signal); 3],
    #[cfg(windows)]
    all: (
        tokio::signal::windows::CtrlC,
        tokio::signal::windows::CtrlClose,
        tokio::signal::windows::CtrlShutdown,
    ),
}

impl Signals {
    /// Catches the signals from now on.
    ///
    /// # Errors
    /// If the system does not allow it.
    #[cfg(unix)]
    pub fn new() -> io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self {
            all: [
                ("SIGINT", signal(SignalKind::interrupt())?),
                ("SIGTERM", signal(SignalKind::terminate())?),
                // A closed terminal.
                ("SIGHUP", signal(SignalKind::hangup())?),
            ],
        })
    }

    /// Waits for the next signal.
    #[cfg(unix)]
    pub async fn next(&mut self) -> &'static str {
        let [(int, a), (term, b), (hup, c)] = &mut self.all;
        tokio::select! {
            _ = a.recv() => int,
            _ = b.recv() => term,
            _ = c.recv() => hup,
        }
    }

    /// Catches the events from now on.
    ///
    /// # Errors
    /// If the system does not allow it.
    #[cfg(windows)]
    pub fn new() -> io::Result<Self> {
        use tokio::signal::windows::{ctrl_c, ctrl_close, ctrl_shutdown};
        Ok(Self {
            all: (ctrl_c()?, ctrl_close()?, ctrl_shutdown()?),
        })
    }

    /// Waits for the next event; Windows kills the process 5 s after the last two.
    #[cfg(windows)]
    pub async fn next(&mut self) -> &'static str {
        let (c, close, shutdown) = &mut self.all;
        tokio::select! {
            _ = c.recv() => "^C",
            _ = close.recv() => "closed window",
            _ = shutdown.recv() => "shutdown",
        }
    }
}

/// Notifies systemd that the daemon is ready, and then at the requested period that it is alive: its threads run and its store goes
/// on with its jobs. A full disk or a locked database does not count as dead.
#[cfg(target_os = "linux")]
pub async fn ready_and_alive(daemon: Daemon) {
    use sd_notify::NotifyState;
    notify_systemd(NotifyState::Ready);
    let Some(within) = sd_notify::watchdog_enabled() else {
        return;
    };
    loop {
        if daemon.upkeep().store_progresses() {
            notify_systemd(NotifyState::Watchdog);
        } else {
            tracing::error!(
                "the store does nothing for half a minute: the watchdog is not notified"
            );
        }
        tokio::time::sleep(within / 3).await;
    }
}

/// No service manager on this system.
#[cfg(not(target_os = "linux"))]
pub async fn ready_and_alive(_: Daemon) {}

/// Notifies systemd that the daemon ends.
pub fn stopping() {
    #[cfg(target_os = "linux")]
    notify_systemd(sd_notify::NotifyState::Stopping);
}

#[cfg(target_os = "linux")]
fn notify_systemd(state: sd_notify::NotifyState<'_>) {
    // Without NOTIFY_SOCKET there is no service manager, which is no error.
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::warn!(%error, "systemd");
    }
}
