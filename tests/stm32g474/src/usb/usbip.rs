//! USB/IP server in front of emulated boards, so that a Linux kernel drives them as if they were plugged in.
//!
//! An import plugs a board in. The kernel's side does not reset the bus or set an address, so the server does both before it
//! answers the import. Every transfer and every unlink gets a response, or the kernel hangs.

use std::collections::HashMap;
use std::io::{self, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

use super::cable::Cable;
use super::transfer::{Outcome, Request, Status};

#[cfg(test)]
mod tests;
pub mod wire;

use wire::{Command, Identity, Operation};

/// Period at which a connection checks that its board is still attached.
const WATCH: Duration = Duration::from_millis(20);
/// Longest real time for a board's reset and its device descriptor: emulation is slow.
const PATIENCE: Duration = Duration::from_secs(60);
/// GET_DESCRIPTOR of the whole device descriptor.
const DEVICE: [u8; 8] = [0x80, 6, 0, 1, 0, 0, 18, 0];

/// Error numbers of Linux.
const PIPE: i32 = -32;
const PROTOCOL: i32 = -71;
const OVERFLOW: i32 = -75;
const CONNECTION_RESET: i32 = -104;
const SHUT_DOWN: i32 = -108;

/// Board that can be imported.
struct Export {
    bus_id: String,
    number: u32,
    cable: Cable,
    taken: AtomicBool,
}

/// USB/IP server, on threads of its own for the life of the process.
pub struct Server {
    address: SocketAddr,
}

impl Server {
    /// Listens on a local port that the system chooses; the boards' bus ids are 1-1, 1-2 and so on.
    ///
    /// # Errors
    /// The system has no free port.
    pub fn start(cables: impl IntoIterator<Item = Cable>) -> io::Result<Self> {
        let export = |(number, cable)| Export {
            bus_id: format!("1-{number}"),
            number,
            cable,
            taken: AtomicBool::new(false),
        };
        let exports: Arc<Vec<_>> = Arc::new((1..).zip(cables).map(export).collect());
        let listener = TcpListener::bind(("127.0.0.1", 0))?;
        let address = listener.local_addr()?;
        thread::spawn(move || {
            for stream in listener.incoming().flatten() {
                let exports = Arc::clone(&exports);
                // A client that disconnects or violates the protocol ends only its own connection.
                thread::spawn(move || drop(serve(stream, &exports)));
            }
        });
        Ok(Self { address })
    }

    /// Address of the server.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

fn serve(mut stream: TcpStream, exports: &[Export]) -> io::Result<()> {
    stream.set_nodelay(true)?;
    match Operation::read(&mut stream)? {
        Operation::List => {
            let free = exports
                .iter()
                .filter(|export| !export.taken.load(Ordering::Relaxed));
            let devices: Vec<_> = free.filter_map(Export::look).collect();
            stream.write_all(&wire::device_list(&devices))
        }
        Operation::Import(bus_id) => {
            let wanted = exports.iter().find(|export| export.bus_id == bus_id);
            let free = wanted.filter(|export| !export.taken.swap(true, Ordering::Relaxed));
            let Some(export) = free else {
                return stream.write_all(&wire::imported(None));
            };
            let ended = export.plugged_in(stream);
            export.cable.unplug();
            export.taken.store(false, Ordering::Relaxed);
            ended
        }
    }
}

impl Export {
    /// Identity of the board, which is plugged in for a moment.
    fn look(&self) -> Option<Identity> {
        let identity = self.plug();
        self.cable.unplug();
        identity
    }

    fn ask(&self, request: Request) -> Option<Outcome> {
        let (sender, receiver) = mpsc::channel();
        let id = self
            .cable
            .submit(request, move |outcome| drop(sender.send(outcome)));
        let outcome = receiver.recv_timeout(PATIENCE).ok();
        if outcome.is_none() {
            self.cable.cancel(id);
        }
        outcome.filter(|outcome| outcome.status == Status::Done)
    }

    fn control(&self, setup: [u8; 8]) -> Option<Outcome> {
        self.ask(Request::Control {
            setup,
            data: Vec::new(),
        })
    }

    /// Plugs the board in, resets the bus and sets the address.
    fn plug(&self) -> Option<Identity> {
        self.cable.plug();
        self.ask(Request::Reset)?;
        let device = self.control(DEVICE)?.data;
        let address = self.number as u8;
        self.control([0, 5, address, 0, 0, 0, 0, 0])?;
        Some(Identity {
            bus_id: self.bus_id.clone(),
            number: self.number,
            device,
        })
    }

    /// Serves the board to the kernel until either side ends the connection.
    fn plugged_in(&self, mut stream: TcpStream) -> io::Result<()> {
        let identity = self.plug();
        stream.write_all(&wire::imported(identity.as_ref()))?;
        if identity.is_none() {
            return Ok(());
        }
        self.cable.be_patient();
        let (answers, arrived) = mpsc::channel::<Vec<u8>>();
        let (mut back, cable) = (stream.try_clone()?, self.cable.clone());
        let writer = thread::spawn(move || {
            loop {
                let written = match arrived.recv_timeout(WATCH) {
                    Ok(bytes) => back.write_all(&bytes),
                    Err(RecvTimeoutError::Timeout) if cable.attached() => Ok(()),
                    Err(_) => break,
                };
                if written.is_err() {
                    break;
                }
            }
            // Unplugged: the end of the connection informs the kernel.
            drop(back.shutdown(Shutdown::Both));
        });
        let pending = Arc::new(Pending {
            answers,
            transfers: Mutex::default(),
        });
        let ended = pending.relay(&mut stream, &self.cable);
        drop(pending);
        self.cable.unplug();
        drop(writer.join());
        ended
    }
}

/// Transfer that the kernel waits for.
#[derive(Clone, Copy, Default)]
struct Waiting {
    /// Number of the transfer on the cable, once it has one.
    id: Option<u64>,
    /// Sequence number of the unlink that cancelled it.
    unlink: Option<u32>,
}

/// Transfers in progress by the kernel's numbers, and the channel for responses to the kernel.
struct Pending {
    answers: Sender<Vec<u8>>,
    transfers: Mutex<HashMap<u32, Waiting>>,
}

impl Pending {
    fn transfers(&self) -> MutexGuard<'_, HashMap<u32, Waiting>> {
        self.transfers
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Queues a response; it is dropped if the writer has ended.
    fn answer(&self, bytes: Vec<u8>) {
        drop(self.answers.send(bytes));
    }

    fn relay(self: &Arc<Self>, stream: &mut TcpStream, cable: &Cable) -> io::Result<()> {
        loop {
            match Command::read(stream)? {
                Command::Unlink { sequence, transfer } => self.unlink(sequence, transfer, cable),
                Command::Submit {
                    sequence,
                    endpoint,
                    input,
                    ends_short,
                    length,
                    setup,
                    data,
                } => {
                    let request = match (endpoint, input) {
                        (0, _) => Request::Control { setup, data },
                        (_, true) => Request::In { endpoint, length },
                        (_, false) => Request::Out {
                            endpoint,
                            data,
                            ends_short,
                        },
                    };
                    self.submit(sequence, input, request, cable);
                }
            }
        }
    }

    fn submit(self: &Arc<Self>, sequence: u32, input: bool, request: Request, cable: &Cable) {
        self.transfers().insert(sequence, Waiting::default());
        let pending = Arc::clone(self);
        let id = cable.submit(request, move |outcome| {
            pending.over(sequence, input, &outcome)
        });
        if let Some(waiting) = self.transfers().get_mut(&sequence) {
            waiting.id = Some(id);
        }
    }

    fn over(&self, sequence: u32, input: bool, outcome: &Outcome) {
        let waiting = self.transfers().remove(&sequence).unwrap_or_default();
        let status = match outcome.status {
            Status::Done => 0,
            Status::Stalled => PIPE,
            Status::Failed => PROTOCOL,
            Status::Overrun => OVERFLOW,
            Status::Gone => SHUT_DOWN,
            Status::Cancelled => CONNECTION_RESET,
        };
        match (outcome.status, waiting.unlink) {
            // Cancelled: the unlink is answered in place of the transfer.
            (Status::Cancelled, Some(unlink)) => self.answer(wire::unlinked(unlink, status)),
            (_, unlink) => {
                let data = if input { outcome.data.as_slice() } else { &[] };
                self.answer(wire::submitted(sequence, status, outcome.length, data));
                // The unlink came too late.
                if let Some(unlink) = unlink {
                    self.answer(wire::unlinked(unlink, 0));
                }
            }
        }
    }

    fn unlink(&self, sequence: u32, transfer: u32, cable: &Cable) {
        let mut transfers = self.transfers();
        let Some(waiting) = transfers.get_mut(&transfer) else {
            // The transfer has ended already.
            return self.answer(wire::unlinked(sequence, 0));
        };
        waiting.unlink = Some(sequence);
        if let Some(id) = waiting.id {
            cable.cancel(id);
        }
    }
}
