//! Connection to the chip behind a debug probe.

use std::time::Duration;

use probe_rs::{Core, MemoryInterface, Session};

use super::registers as reg;
use super::running_target::RunningTarget;
use super::{ProbeInfo, Probes, errors};
use crate::programmer::{FlashStep, ProgramError};

/// Time limit for halting the core.
pub const HALTED_WITHIN: Duration = Duration::from_millis(500);

/// State of a connection.
#[derive(Debug)]
enum State {
    /// Not connected, for example after a reset; the next access connects.
    None,
    /// Debug port only; the program keeps running.
    Running(RunningTarget),
    /// Session of probe-rs, which halts the core at its beginning and its end.
    Session(Box<Session>),
}

/// Connection that is made and changed by each access as needed.
#[derive(Debug)]
pub struct ProbeConnection {
    probes: Probes,
    info: ProbeInfo,
    state: State,
}

impl ProbeConnection {
    /// Creates a connection over the debug port.
    pub fn new(probes: Probes, info: ProbeInfo, target: RunningTarget) -> Self {
        Self {
            probes,
            info,
            state: State::Running(target),
        }
    }

    /// The probe.
    pub fn probe(&self) -> &ProbeInfo {
        &self.info
    }

    /// Opens a session, for changing the chip: the core is halted.
    pub fn session(&mut self) -> Result<&mut Session, ProgramError> {
        if !matches!(self.state, State::Session(_)) {
            self.open_bridge()?;
            // A probe is exclusive.
            self.detach();
            let session = self.probes.session(&self.info)?;
            self.state = State::Session(Box::new(session));
        }
        match &mut self.state {
            State::Session(session) => Ok(session),
            _ => unreachable!("it was just made"),
        }
    }

    /// Switches the timer's outputs off. They were off at the caller's check, but the program may have switched them on since, and
    /// a session halts it with the outputs as they are.
    fn open_bridge(&mut self) -> Result<(), ProgramError> {
        if self.read_word(FlashStep::Attaching, reg::APB2ENR)? & reg::HRTIM1EN == 0 {
            return Ok(());
        }
        match &mut self.state {
            State::Running(target) => {
                let opened = target.set_word(reg::ODISR, reg::OUTPUTS);
                opened.map_err(|why| errors::access(FlashStep::Attaching, &why))
            }
            _ => Ok(()),
        }
    }

    /// Disconnects; the next access connects again.
    pub fn detach(&mut self) {
        self.state = State::None;
    }

    /// Runs `work` with the core, in a session.
    pub fn core<T>(
        &mut self,
        doing: FlashStep,
        work: impl FnOnce(&mut Core<'_>) -> Result<T, probe_rs::Error>,
    ) -> Result<T, ProgramError> {
        let session = self.session()?;
        let done = session.core(0).and_then(|mut core| work(&mut core));
        done.map_err(|why| errors::access(doing, &why))
    }

    /// Reads memory of any length at any address.
    pub fn read(
        &mut self,
        doing: FlashStep,
        address: u32,
        out: &mut [u8],
    ) -> Result<(), ProgramError> {
        if matches!(self.state, State::None) {
            self.state = State::Running(self.probes.attach_running(&self.info)?);
        }
        match &mut self.state {
            State::Running(target) => {
                let read = target.read(address, out);
                read.map_err(|why| errors::access(doing, &why))
            }
            _ => self.core(doing, |core| core.read(address.into(), out)),
        }
    }

    /// Reads a word.
    pub fn read_word(&mut self, doing: FlashStep, address: u32) -> Result<u32, ProgramError> {
        if matches!(self.state, State::None) {
            self.state = State::Running(self.probes.attach_running(&self.info)?);
        }
        match &mut self.state {
            State::Running(target) => {
                let read = target.read_word(address);
                read.map_err(|why| errors::access(doing, &why))
            }
            _ => self.core(doing, |core| core.read_word_32(address.into())),
        }
    }
}
