//! The cable: what other threads hold of the host's controller.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Sender};
use std::time::Duration;

use super::host::HostController;
use super::transfer::{Done, Outcome, Request};

/// What the controller is asked for.
pub(super) enum Command {
    Plug(bool),
    Submit(u64, Request, Done),
    Cancel(u64),
}

/// What both ends see.
#[derive(Default)]
pub(super) struct Shared {
    pub attached: AtomicBool,
    pub ended: AtomicBool,
    pub patient: AtomicBool,
    pub now_ns: AtomicU64,
    pub next_id: AtomicU64,
}

/// A cable with a board at the other end: held by the threads that play the host's drivers.
#[derive(Clone)]
pub struct Cable {
    commands: Sender<Command>,
    shared: Arc<Shared>,
}

impl Cable {
    /// A cable, unplugged, and the controller that the machine polls.
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

    /// Pulls the cable out: every transfer ends.
    pub fn unplug(&self) {
        self.command(Command::Plug(false));
    }

    /// Asks for a transfer; `done` takes its end, or is dropped with the machine.
    pub fn submit(&self, request: Request, done: impl FnOnce(Outcome) + Send + 'static) -> u64 {
        let id = self.shared.next_id.fetch_add(1, Ordering::Relaxed);
        self.command(Command::Submit(id, request, Box::new(done)));
        id
    }

    /// Takes a transfer back, if it is not over: then it ends as cancelled.
    pub fn cancel(&self, id: u64) {
        self.command(Command::Cancel(id));
    }

    /// Whether the board is plugged in and says so.
    pub fn attached(&self) -> bool {
        self.shared.attached.load(Ordering::Relaxed)
    }

    /// From now on emulated time waits for a host that is slower than the board, as a whole emulated computer is: it
    /// stands still while whoever reads all the time has not asked for more.
    pub fn be_patient(&self) {
        self.shared.patient.store(true, Ordering::Relaxed);
    }

    /// Whether the machine is gone.
    pub fn ended(&self) -> bool {
        self.shared.ended.load(Ordering::Relaxed)
    }

    /// Emulated time.
    pub fn now(&self) -> Duration {
        Duration::from_nanos(self.shared.now_ns.load(Ordering::Relaxed))
    }

    /// A machine that is gone takes no commands; what waits for their ends sees it.
    fn command(&self, command: Command) {
        let _ = self.commands.send(command);
    }
}
