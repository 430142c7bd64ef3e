//! Reading and writing memory beside a program that runs.
//!
//! A session of probe-rs halts the core when it begins and when it ends, to clear breakpoints, for as long as some twenty
//! transfers take: while the bridge switches nobody protects it then. What only looks goes by the debug port alone.

use std::fmt;

use probe_rs::Error;
use probe_rs::architecture::arm::dp::DpAddress;
use probe_rs::architecture::arm::memory::ArmMemoryInterface;
use probe_rs::architecture::arm::sequences::DefaultArmSequence;
use probe_rs::architecture::arm::{ArmDebugInterface, FullyQualifiedApAddress};
use probe_rs::probe::Probe;

use super::registers as reg;

/// The AHB-AP of a Cortex-M4.
const ACCESS_PORT: FullyQualifiedApAddress = FullyQualifiedApAddress::v1_with_default_dp(0);

/// The debug port of a chip, its core left alone.
pub struct Quiet(Box<dyn ArmDebugInterface>);

impl fmt::Debug for Quiet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Quiet")
    }
}

impl Quiet {
    /// Connects. The chip's debug unit is told to answer while the core sleeps, which it does most of the time.
    pub fn connect(mut probe: Probe) -> Result<Self, Error> {
        probe.attach_to_unspecified()?;
        let sequence = DefaultArmSequence::create();
        let interface = probe.try_into_arm_debug_interface(sequence);
        let mut quiet = Self(interface.map_err(|(_, why)| why)?);
        quiet.0.select_debug_port(DpAddress::Default)?;
        quiet.with(|memory| {
            let control = memory.read_word_32(reg::DBGMCU_CR.into())?;
            memory.write_word_32(reg::DBGMCU_CR.into(), control | reg::DBG_WHILE_ASLEEP)
        })?;
        Ok(quiet)
    }

    fn with<T>(
        &mut self,
        access: impl FnOnce(
            &mut dyn ArmMemoryInterface,
        ) -> Result<T, probe_rs::architecture::arm::ArmError>,
    ) -> Result<T, Error> {
        let mut memory = self.0.memory_interface(&ACCESS_PORT)?;
        Ok(access(&mut *memory)?)
    }

    /// Reads bytes, wherever they lie.
    pub fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), Error> {
        self.with(|memory| memory.read(address.into(), out))
    }

    /// Reads words in one go each.
    pub fn read_words(&mut self, address: u32, out: &mut [u32]) -> Result<(), Error> {
        self.with(|memory| memory.read_32(address.into(), out))
    }

    /// Reads a word.
    pub fn word(&mut self, address: u32) -> Result<u32, Error> {
        self.with(|memory| memory.read_word_32(address.into()))
    }

    /// Writes a word of RAM.
    pub fn set_word(&mut self, address: u32, value: u32) -> Result<(), Error> {
        self.with(|memory| memory.write_word_32(address.into(), value))
    }
}
