//! CRC unit: 32 bits, with the polynomial and the bit reversals of its registers (RM0440, 16).

use crate::registers::crc;
use crate::violation::Log;

use super::register_file::RegisterFile;

/// CRC unit with its current value.
#[derive(Clone, Debug)]
pub struct Checksum(u32);

impl Default for Checksum {
    /// Value of DR and INIT after reset.
    fn default() -> Self {
        Self(u32::MAX)
    }
}

impl Checksum {
    /// Reads DR.
    pub fn read(&self, file: &RegisterFile) -> u32 {
        if file.is(crc::cr::REV_OUT) {
            self.0.reverse_bits()
        } else {
            self.0
        }
    }

    /// Handles a write of `bytes` before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        bytes: usize,
        value: u32,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        match address {
            crc::dr::ADDRESS => {
                if bytes != 4 || file.is(crc::cr::POLYSIZE) {
                    log.broken("CRC: this emulator takes words, and a polynomial of 32 bits");
                }
                self.take(value, file);
                file.word(address)
            }
            crc::cr::ADDRESS => {
                if crc::cr::RESET.extract(value) == 1 {
                    self.0 = file.get(crc::init::CRC_INIT);
                }
                crc::cr::RESET.put(value, 0)
            }
            // "The CRC_INIT register … writing it initialises DR" (RM0440 16.4.4).
            crc::init::ADDRESS => {
                self.0 = value;
                value
            }
            _ => value,
        }
    }

    fn take(&mut self, word: u32, file: &RegisterFile) {
        let word = match file.get(crc::cr::REV_IN) {
            0 => word,
            1 => word.reverse_bits().swap_bytes(),
            2 => word.reverse_bits().rotate_left(16),
            _ => word.reverse_bits(),
        };
        let polynomial = file.get(crc::pol::POL);
        self.0 ^= word;
        for _ in 0..32 {
            let carry = self.0 >> 31 == 1;
            self.0 = self.0 << 1 ^ if carry { polynomial } else { 0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// CRC-32/ISO-HDLC is specified by its check value for "123456789"; the first eight bytes of that give 0x9AE0_DAAF (zlib).
    #[test]
    fn with_both_reversals_it_is_the_crc_32_of_zlib() {
        let (mut file, mut log, mut unit) =
            (RegisterFile::default(), Log::default(), Checksum::default());
        file.set(crc::cr::REV_IN, 3);
        file.set(crc::cr::REV_OUT, 1);
        for word in [*b"1234", *b"5678"] {
            let word = u32::from_le_bytes(word);
            unit.write(crc::dr::ADDRESS, 4, word, &file, &mut log);
        }
        assert_eq!(!unit.read(&file), 0x9AE0_DAAF);
        assert!(log.violations.is_empty());
    }
}
