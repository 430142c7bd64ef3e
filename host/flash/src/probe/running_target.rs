//! Access to memory while the program runs.
//!
//! A session of probe-rs halts the core at its beginning and end to clear breakpoints, for some twenty transfers. That opens the
//! bridge of a hob that heats. Accesses that only read therefore use the debug port alone.

use std::fmt;

use probe_rs::Error;
use probe_rs::architecture::arm::dp::DpAddress;
use probe_rs::architecture::arm::memory::ArmMemoryInterface;
use probe_rs::architecture::arm::sequences::DefaultArmSequence;
use probe_rs::architecture::arm::{ArmDebugInterface, FullyQualifiedApAddress};
use probe_rs::probe::Probe;

use super::registers as reg;

/// AHB-AP of a Cortex-M4.
const ACCESS_PORT: FullyQualifiedApAddress = FullyQualifiedApAddress::v1_with_default_dp(0);

/// Debug port of a chip whose core keeps running.
pub struct RunningTarget(Box<dyn ArmDebugInterface>);

impl fmt::Debug for RunningTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RunningTarget")
    }
}

impl RunningTarget {
    /// Connects. Sets the chip's debug unit to answer while the core sleeps, as it does most of the time.
    pub fn connect(mut probe: Probe) -> Result<Self, Error> {
        probe.attach_to_unspecified()?;
        let sequence = DefaultArmSequence::create();
        let interface = probe.try_into_arm_debug_interface(sequence);
        let mut target = Self(interface.map_err(|(_, why)| why)?);
        target.0.select_debug_port(DpAddress::Default)?;
        target.with(|memory| {
            let control = memory.read_word_32(reg::DBGMCU_CR.into())?;
            memory.write_word_32(reg::DBGMCU_CR.into(), control | reg::DBG_WHILE_ASLEEP)
        })?;
        Ok(target)
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

    /// Reads bytes at any address.
    pub fn read(&mut self, address: u32, out: &mut [u8]) -> Result<(), Error> {
        self.with(|memory| memory.read(address.into(), out))
    }

    /// Reads words, each in one transfer.
    pub fn read_words(&mut self, address: u32, out: &mut [u32]) -> Result<(), Error> {
        self.with(|memory| memory.read_32(address.into(), out))
    }

    /// Reads a word.
    pub fn read_word(&mut self, address: u32) -> Result<u32, Error> {
        self.with(|memory| memory.read_word_32(address.into()))
    }

    /// Writes a word of RAM or a register.
    pub fn set_word(&mut self, address: u32, value: u32) -> Result<(), Error> {
        self.with(|memory| memory.write_word_32(address.into(), value))
    }
}
