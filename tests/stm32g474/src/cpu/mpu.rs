//! Memory protection unit (Armv7-M Architecture Reference Manual, B3.5): regions without access, over the default memory map.

use crate::violation::Log;

/// Offsets of the registers from 0xE000E000.
const CTRL: u32 = 0xD94;
const RNR: u32 = 0xD98;
const RBAR: u32 = 0xD9C;
const RASR: u32 = 0xDA0;

/// MPU_CTRL: ENABLE, PRIVDEFENA.
const ENABLE: u32 = 1;
const DEFAULT_MAP: u32 = 1 << 2;

/// MPU_RBAR, VALID: the write also selects the region.
const VALID: u32 = 1 << 4;

/// MPU_RASR: SRD and AP.
const SUBREGIONS: u32 = 0xFF << 8;
const ACCESS: u32 = 0b111 << 24;

/// Registers of the unit.
#[derive(Clone, Debug, Default)]
pub struct Mpu {
    control: u32,
    number: u32,
    /// RBAR and RASR of each region.
    regions: [(u32, u32); 8],
}

impl Mpu {
    /// Writes a register at an offset from 0xE000E000; returns `true` if it belongs to the unit.
    pub fn write(&mut self, offset: u32, value: u32, log: &mut Log) -> bool {
        match offset {
            CTRL => {
                if value & ENABLE != 0 && value & DEFAULT_MAP == 0 {
                    log.broken("MPU: this emulator has the default memory map behind the regions");
                }
                self.control = value;
            }
            RNR => self.number = value & 7,
            RBAR => {
                if value & VALID != 0 {
                    self.number = value & 7;
                }
                self.region().0 = value & !0x1F;
            }
            RASR => {
                if value & ENABLE != 0 && value & (ACCESS | SUBREGIONS) != 0 {
                    log.broken("MPU: this emulator has whole regions without access only");
                }
                self.region().1 = value;
            }
            _ => return false,
        }
        true
    }

    /// Reads a register at an offset from 0xE000E000.
    pub fn read(&self, offset: u32) -> Option<u32> {
        let (base, attributes) = self.regions[self.number as usize];
        match offset {
            CTRL => Some(self.control),
            RNR => Some(self.number),
            RBAR => Some(base | self.number),
            RASR => Some(attributes),
            _ => None,
        }
    }

    fn region(&mut self) -> &mut (u32, u32) {
        &mut self.regions[self.number as usize]
    }

    /// Returns `true` if no access to an address is allowed.
    pub fn denies(&self, address: u32) -> bool {
        let is_in = |&(base, attributes): &(u32, u32)| {
            let size = 2u64 << (attributes >> 1 & 0x1F);
            let at = u64::from(address).wrapping_sub(u64::from(base));
            attributes & ENABLE != 0 && at < size
        };
        self.control & ENABLE != 0 && self.regions.iter().any(is_in)
    }
}
