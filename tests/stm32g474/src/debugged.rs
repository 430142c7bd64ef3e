//! Board behind a debug port, to which probe-rs attaches in tests.

use std::fmt;

use ihd_debug_port::{BusFault, Contact, Stop, Target};

use crate::bench::Bench;
use crate::machine::{Machine, Stands};
use crate::time::{Ticks, us};

/// Emulated time between two accesses of a probe while the processor runs. A probe at 4 MHz makes some forty accesses in a
/// millisecond.
const BETWEEN_ACCESSES: Ticks = us(25);

/// Emulated time between two accesses while the flash controller is busy, as a flash algorithm waits for it.
const BUSY: Ticks = us(2_000);

/// Board as a debug port accesses it.
pub struct DebuggedBoard {
    bench: Bench,
    contact: Contact,
}

impl DebuggedBoard {
    /// Board behind a probe that works.
    pub fn new(bench: Bench) -> Self {
        Self {
            bench,
            contact: Contact::Good,
        }
    }

    /// Sets the contact between probe and board, for fault injection.
    pub fn set_contact(&mut self, contact: Contact) {
        self.contact = contact;
    }

    fn with<R: Send + 'static>(&self, job: impl FnOnce(&mut Machine) -> R + Send + 'static) -> R {
        self.bench.with(job)
    }
}

impl fmt::Debug for DebuggedBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("DebuggedBoard")
            .field("contact", &self.contact)
            .finish_non_exhaustive()
    }
}

impl Target for DebuggedBoard {
    fn read(&mut self, address: u32, bytes: u32) -> Result<u32, BusFault> {
        self.with(move |machine| machine.bus_read(address, bytes))
            .ok_or(BusFault)
    }

    fn write(&mut self, address: u32, bytes: u32, value: u32) -> Result<(), BusFault> {
        self.with(move |machine| machine.bus_write(address, bytes, value))
            .ok_or(BusFault)
    }

    fn register(&mut self, number: u32) -> u32 {
        self.with(move |machine| machine.register(number))
    }

    fn set_register(&mut self, number: u32, value: u32) {
        self.with(move |machine| machine.set_register(number, value));
    }

    fn halt(&mut self) {
        self.with(|machine| machine.halt().expect("the emulator runs"));
    }

    fn run(&mut self) {
        self.with(|machine| machine.go_on().expect("the emulator runs"));
    }

    fn step(&mut self) {
        self.with(|machine| machine.step_once().expect("the emulator runs"));
    }

    fn reset(&mut self) {
        self.with(|machine| machine.reset_by_debugger().expect("the emulator runs"));
    }

    fn stopped(&mut self) -> Option<Stop> {
        self.with(|machine| {
            if machine.stands().is_none() {
                let flash = machine.chip().flash.next();
                let time = flash.map_or(BETWEEN_ACCESSES, |_| BUSY);
                machine.run_for(time).expect("the emulator runs");
            }
            match machine.stands() {
                Some(Stands::Breakpoint) => Some(Stop::Breakpoint),
                Some(Stands::Halted) => Some(Stop::Asked),
                None if machine.is_locked_up() => Some(Stop::LockedUp),
                None => None,
            }
        })
    }

    fn contact(&self) -> Contact {
        self.contact
    }
}
