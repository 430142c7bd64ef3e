//! The STM32G474's option bytes, as far as this firmware depends on them (RM0440, 3.4.2 and 3.7.8).

use serde::Serialize;

/// First address of the option bytes in flash; those of the second bank are [`SECOND_BANK`] further on.
pub const OPTION_BYTES_ADDRESS: u32 = 0x1FFF_7800;

/// Distance of the second bank's option bytes.
pub const SECOND_BANK: u32 = 0x8000;

const BOR_LEV: u32 = 0b111 << 8;
const BFB2: u32 = 1 << 20;
const DBANK: u32 = 1 << 22;
const SRAM_PE: u32 = 1 << 24;
const N_SWBOOT0: u32 = 1 << 26;
const N_BOOT0: u32 = 1 << 27;
/// Bit 0 of NRST_MODE: 1 is a reset input, 3 an output as well, 2 a GPIO.
const NRST_INPUT: u32 = 1 << 28;

/// Read protection of a chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReadProtection {
    /// None: 0xAA.
    None,
    /// Level 1: flash cannot be read or written by a probe or a bootloader; removing it erases the chip.
    Level1,
    /// Level 2, irreversible: no probe, no bootloader. 0xCC.
    Level2,
}

/// Option that differs from the firmware's requirement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OptionDeviation {
    /// Name in the reference manual.
    pub name: &'static str,
    /// Value on the chip.
    pub is: u32,
    /// Required value.
    #[serde(rename = "wanted")]
    pub required: u32,
    /// `true` if the firmware does not heat without it, `false` if it works with less margin.
    pub needed: bool,
    /// Purpose.
    pub why: &'static str,
}

/// Values of the option bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OptionBytes {
    /// `FLASH_OPTR`.
    pub optr: u32,
    /// `FLASH_WRP1AR`, `FLASH_WRP1BR`, `FLASH_WRP2AR`, `FLASH_WRP2BR`: write-protected pages, first in bits 6:0, last in bits
    /// 22:16; none if the first is greater than the last.
    pub wrp: [u32; 4],
}

impl Default for OptionBytes {
    /// Values of a chip as delivered by ST.
    fn default() -> Self {
        Self {
            optr: 0xFFEF_F8AA,
            wrp: [0xFF00_FFFF; 4],
        }
    }
}

impl OptionBytes {
    /// Returns `true` if the flash has two banks: a page of one can be erased while the program runs from the other.
    pub fn has_two_banks(&self) -> bool {
        self.optr & DBANK != 0
    }

    /// Returns `true` if the pin BOOT0 chooses between flash and bootloader, `false` if the option bit nBOOT0 does.
    pub fn boots_by_pin(&self) -> bool {
        self.optr & N_SWBOOT0 != 0
    }

    /// Level of the brown-out reset: 0 (1.7 V) to 4 (2.8 V).
    pub fn bor_level(&self) -> u32 {
        (self.optr & BOR_LEV) >> 8
    }

    /// Use of the reset pin, NRST_MODE.
    pub fn reset_pin(&self) -> u32 {
        self.optr >> 28 & 0b11
    }

    /// Read protection.
    pub fn read_protection(&self) -> ReadProtection {
        match self.optr & 0xFF {
            0xAA => ReadProtection::None,
            0xCC => ReadProtection::Level2,
            _ => ReadProtection::Level1,
        }
    }

    /// Write-protected pages: bank (0 or 1), first and last page.
    pub fn protected_pages(&self) -> Vec<(usize, u32, u32)> {
        let areas = self.wrp.iter().enumerate();
        areas
            .map(|(index, area)| (index / 2, area & 0x7F, area >> 16 & 0x7F))
            .filter(|(_, first, last)| first <= last)
            .collect()
    }

    /// Options that differ from the firmware's requirements.
    pub fn deviations(&self) -> Vec<OptionDeviation> {
        let bit = |mask: u32| u32::from(self.optr & mask != 0);
        let all = [
            OptionDeviation {
                name: "DBANK",
                is: bit(DBANK),
                required: 1,
                needed: true,
                why: "a lookup is kept in the second bank while the program runs from the first",
            },
            OptionDeviation {
                name: "SRAM_PE",
                is: bit(SRAM_PE),
                required: 0,
                needed: true,
                why: "parity guards the RAM that holds code and data of the sampling path",
            },
            OptionDeviation {
                name: "BFB2",
                is: bit(BFB2),
                required: 0,
                needed: true,
                why: "the program begins in the first bank",
            },
            OptionDeviation {
                name: "nBOOT0",
                is: bit(N_BOOT0),
                required: 1,
                needed: !self.boots_by_pin(),
                why: "with 0 the chip starts its bootloader instead of the program where nSWBOOT0 is 0",
            },
            OptionDeviation {
                name: "nSWBOOT0",
                is: bit(N_SWBOOT0),
                required: 1,
                needed: false,
                why: "the pin BOOT0 reaches the bootloader when a program does not run",
            },
            OptionDeviation {
                name: "BOR_LEV",
                is: self.bor_level(),
                required: 4,
                needed: false,
                why: "below 2.8 V the chip stays in reset, its outputs open",
            },
            OptionDeviation {
                name: "NRST_MODE",
                is: self.reset_pin(),
                required: if self.optr & NRST_INPUT != 0 {
                    self.reset_pin()
                } else {
                    3
                },
                needed: false,
                why: "the reset pin is a GPIO, and the reset button does nothing",
            },
        ];
        all.into_iter()
            .filter(|one| one.is != one.required)
            .collect()
    }

    /// Returns these values with all requirements met; protections stay.
    pub fn with_requirements(&self) -> Self {
        let set = DBANK | N_BOOT0 | N_SWBOOT0 | NRST_INPUT | 4 << 8;
        let clear = SRAM_PE | BFB2 | BOR_LEV;
        Self {
            optr: self.optr & !clear | set,
            wrp: self.wrp,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The reset value in RM0440, 3.7.8.
    #[test]
    fn as_delivered_parity_and_the_brown_out_level_differ() {
        let names = |options: OptionBytes| {
            let all = options.deviations();
            all.iter()
                .map(|one| (one.name, one.needed))
                .collect::<Vec<_>>()
        };
        let delivered = OptionBytes::default();
        assert_eq!(names(delivered), [("SRAM_PE", true), ("BOR_LEV", false)]);
        assert_eq!(delivered.read_protection(), ReadProtection::None);
        assert_eq!(delivered.protected_pages(), []);
        let corrected = delivered.with_requirements();
        assert_eq!(corrected.optr, 0xFEEF_FCAA);
        assert_eq!(names(corrected), []);
    }

    #[test]
    fn a_chip_that_never_starts_its_program_is_told() {
        // nSWBOOT0 = 0, nBOOT0 = 0.
        let options = OptionBytes {
            optr: 0xF3EF_FCAA & !SRAM_PE,
            ..Default::default()
        };
        let deviations = options.deviations();
        let names: Vec<_> = deviations
            .iter()
            .map(|one| (one.name, one.needed))
            .collect();
        assert_eq!(names, [("nBOOT0", true), ("nSWBOOT0", false)]);
    }

    /// RM0440, 3.7.8, NRST_MODE: 1 reset input, 2 GPIO, 3 input and output.
    #[test]
    fn a_reset_pin_that_is_a_gpio_is_told_and_set_right() {
        let with = |mode: u32| OptionBytes {
            optr: 0xCEEF_FCAA | mode << 28,
            ..Default::default()
        };
        assert_eq!(
            (with(1).deviations(), with(3).deviations()),
            (vec![], vec![])
        );
        let told = with(2).deviations();
        assert_eq!((told[0].name, told[0].is, told.len()), ("NRST_MODE", 2, 1));
        assert_eq!(with(2).with_requirements(), with(3));
    }

    #[test]
    fn protections_are_read() {
        let options = OptionBytes {
            optr: 0xFFEF_F8BB,
            wrp: [0xFF00_FFFF, 0xFF03_FF00, 0xFF7F_FF7E, 0xFF00_FFFF],
        };
        assert_eq!(options.read_protection(), ReadProtection::Level1);
        assert_eq!(options.protected_pages(), [(0, 0, 3), (1, 126, 127)]);
        assert_eq!(options.with_requirements().wrp, options.wrp);
        let forever = OptionBytes {
            optr: 0xFFEF_F8CC,
            ..options
        };
        assert_eq!(forever.read_protection(), ReadProtection::Level2);
    }
}
