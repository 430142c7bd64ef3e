//! USB cable: the handle by which other threads use the host controller.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Sender};
use std::time::Duration;

use super::host::HostController;
use super::transfer::{Done, Outcome, Request};

/// Command to the host controller.
pub(super) enum Command {
    Plug(bool),
    Submit(u64, Request, Done),
    Cancel(u64),
}

/// State shared by both ends.
#[derive(Default)]
pub(super) struct Shared {
    pub attached: AtomicBool,
    pub ended: AtomicBool,
    pub patient: AtomicBool,
    pub now_ns: AtomicU64,
    pub next_id: AtomicU64,
}

/// Cable with a board at the other end, for the threads that act as the host's drivers.
#[derive(Clone)]
pub struct Cable {
    commands: Sender<Command>,
    shared: Arc<Shared>,
}

impl Cable {
    /// Unplugged cable, and the host controller that the machine polls.
    pub fn new() -> (Self, HostController) {
        let (commands, receiver) = mpsc::channel();
        let shared = Arc::<Shared>::default();
        let controller = HostController::new(receiver, Arc::clone(&shared));
        (Self { commands, shared }, controller)
    }

    /// Plugs the board in.
    pub fn plug(&self) {
        self.command(Command::Plug(true));
    }

    /// Unplugs the cable: every transfer ends.
    pub fn unplug(&self) {
        self.command(Command::Plug(false));
    }

    /// Submits a transfer and returns its number; `done` is called at its end, or dropped with the machine.
    pub fn submit(&self, request: Request, done: impl FnOnce(Outcome) + Send + 'static) -> u64 {
        let id = self.shared.next_id.fetch_add(1, Ordering::Relaxed);
        self.command(Command::Submit(id, request, Box::new(done)));
        id
    }

    /// Cancels a transfer that has not ended; it then ends as cancelled.
    pub fn cancel(&self, id: u64) {
        self.command(Command::Cancel(id));
    }

    /// Returns `true` if the board is plugged in and attached.
    pub fn attached(&self) -> bool {
        self.shared.attached.load(Ordering::Relaxed)
    }

    /// Makes emulated time wait for a host that is slower than the board, such as a whole emulated computer: time stops while a
    /// pipe that is read continuously has no pending request.
    pub fn be_patient(&self) {
        self.shared.patient.store(true, Ordering::Relaxed);
    }

    /// Returns `true` if the machine has ended.
    pub fn ended(&self) -> bool {
        self.shared.ended.load(Ordering::Relaxed)
    }

    /// Emulated time.
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.shared.now_ns.load(Ordering::Relaxed))
    }

    /// Sends a command. If the machine has ended, the command is dropped together with its `done`.
    fn command(&self, command: Command) {
        let _ = self.commands.send(command);
    }
}
