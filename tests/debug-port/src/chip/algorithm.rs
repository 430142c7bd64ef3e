//! ST's flash algorithm, done instead of run: its entry points and its code are those of the target's description.

use ihd_shared::image::{FLASH_ADDRESS, PAGE_BYTES};

use super::flash::{cr, sr};
use super::{Chip, Mishap};
use crate::target::{Contact, Target};

/// The description that the program itself uses.
const DESCRIPTION: &str = include_str!("../../../../host/flash/targets/STM32G474.yaml");

const KEYR: u32 = 0x4002_2008;
const SR: u32 = 0x4002_2010;
const CR: u32 = 0x4002_2014;
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Entry point of the algorithm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Routine {
    Init,
    UnInit,
    EraseChip,
    EraseSector,
    ProgramPage,
}

/// Start of each routine, and the code that must be in RAM.
#[derive(Debug)]
pub struct Algorithm {
    entries: Vec<(u32, Routine)>,
    code: Vec<u8>,
}

impl Algorithm {
    /// Description's algorithm.
    ///
    /// # Panics
    /// When it lacks something, which is a broken test.
    pub fn of_st() -> Self {
        let field = |name: &str| {
            let mut lines = DESCRIPTION.lines().map(str::trim);
            let line = lines.find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
            line.expect("a field of the description")
        };
        let number = |name| {
            let digits = field(name).strip_prefix("0x").expect("hexadecimal");
            u32::from_str_radix(digits, 16).expect("a number")
        };
        let base = number("load_address");
        let entries = [
            ("pc_init", Routine::Init),
            ("pc_uninit", Routine::UnInit),
            ("pc_erase_all", Routine::EraseChip),
            ("pc_erase_sector", Routine::EraseSector),
            ("pc_program_page", Routine::ProgramPage),
        ];
        Self {
            entries: entries
                .map(|(name, routine)| ((base + number(name)) & !1, routine))
                .to_vec(),
            code: base64(field("instructions")),
        }
    }

    /// The routine that begins at an address.
    pub fn at(&self, pc: u32) -> Option<Routine> {
        let found = self.entries.iter().find(|(entry, _)| *entry == pc & !1);
        found.map(|(_, routine)| *routine)
    }

    /// Returns `true` if these bytes begin with the code; a partial download does not run.
    pub fn is_in(&self, ram: &[u8]) -> bool {
        ram.starts_with(&self.code)
    }
}

fn base64(text: &str) -> Vec<u8> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let digits = text
        .bytes()
        .filter_map(|byte| DIGITS.iter().position(|&digit| digit == byte));
    let digits: Vec<_> = digits.collect();
    let groups = digits.chunks(4).flat_map(|group| {
        let bits = group.iter().fold(0, |bits, digit| bits << 6 | digit) << (6 * (4 - group.len()));
        let bytes = [bits >> 16, bits >> 8, bits].map(|byte| byte as u8);
        bytes.into_iter().take(group.len() - 1)
    });
    groups.collect()
}

impl Chip {
    /// Runs a routine on the controller and returns its result; `None` if it never returns.
    pub(super) fn perform(&mut self, routine: Routine) -> Option<u32> {
        let [r0, r1, r2, ..] = self.registers;
        match routine {
            Routine::Init => {
                if self.flash.register(CR) & cr::LOCK != 0 {
                    for key in KEYS {
                        self.flash.set_register(KEYR, key).ok()?;
                    }
                }
                self.flash.set_register(SR, sr::ERRORS).ok()?;
                Some(0)
            }
            Routine::UnInit => {
                let control = self.flash.register(CR) | cr::LOCK;
                self.flash.set_register(CR, control).ok()?;
                Some(0)
            }
            Routine::EraseChip => self.erase(cr::MER, 0),
            Routine::EraseSector => {
                let page = r0.checked_sub(FLASH_ADDRESS)? / PAGE_BYTES;
                let bank = if page >= 128 { cr::BKER } else { 0 };
                self.erase(cr::PER | bank | (page % 128) << cr::PNB, page)
            }
            Routine::ProgramPage => self.program_page(r0, r1, r2),
        }
    }

    fn erase(&mut self, what: u32, page: u32) -> Option<u32> {
        self.flash.set_register(SR, sr::ERRORS).ok()?;
        match self.meet_mishap() {
            Err(Mishap::PowerLost) => {
                self.flash.tear(page);
                return None;
            }
            Err(_) => return None,
            Ok(_) => {}
        }
        self.flash.set_register(CR, what | cr::STRT).ok()?;
        self.flash.set_register(CR, 0).ok()?;
        Some(self.result())
    }

    fn program_page(&mut self, address: u32, bytes: u32, buffer: u32) -> Option<u32> {
        self.flash.set_register(SR, sr::ERRORS).ok()?;
        self.flash.set_register(CR, cr::PG).ok()?;
        for offset in (0..bytes).step_by(8) {
            let low = self.read(buffer + offset, 4).ok()?;
            let high = self.read(buffer + offset + 4, 4).ok()?;
            let mut value = (u64::from(high) << 32 | u64::from(low)).to_le_bytes();
            if self.meet_mishap().ok()? {
                value[3] ^= 0x10;
            }
            self.flash.program(address + offset, value);
            if self.result() != 0 {
                return Some(1);
            }
        }
        self.flash.set_register(CR, 0).ok()?;
        Some(0)
    }

    fn result(&self) -> u32 {
        u32::from(self.flash.register(SR) & sr::ERRORS != 0)
    }

    /// Applies the fault that is due before an operation: a bit of it stays, or it is not carried out, with the reason.
    fn meet_mishap(&mut self) -> Result<bool, Mishap> {
        match self.next_mishap() {
            None => Ok(false),
            Some(Mishap::BitStays) => Ok(true),
            Some(Mishap::ProbePulled) => {
                self.cut(Contact::NoProbe);
                Ok(false)
            }
            Some(lost @ Mishap::PowerLost) => {
                self.cut(Contact::NoPower);
                Err(lost)
            }
            Some(stuck @ Mishap::Stuck) => {
                self.flash.stuck = true;
                Err(stuck)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_description_is_read() {
        let algorithm = Algorithm::of_st();
        assert_eq!(algorithm.at(0x2000_0020), Some(Routine::Init));
        assert_eq!(
            algorithm.at(0x2000_0020 + 0x10E),
            Some(Routine::ProgramPage)
        );
        assert_eq!(algorithm.at(0x2000_0022), None);
        // push {r4, r5, r6, lr}
        assert_eq!(algorithm.code[..2], [0x70, 0xB5]);
        // `base64 -d | wc -c` of the same line.
        assert_eq!(algorithm.code.len(), 436);
    }

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (text, bytes) in [
            ("Zm9vYmFy", "foobar"),
            ("Zm9vYg==", "foob"),
            ("Zm9vYmE=", "fooba"),
        ] {
            assert_eq!(base64(text), bytes.as_bytes());
        }
    }
}
