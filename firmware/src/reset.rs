//! Why the controller started: what the reset flags say, and the crash record in memory that a reset
//! does not clear.

/// Reason in [`ihd_shared::wire::messages::Hello::reset_reason`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// Power came on.
    PowerOn = 0,
    /// The watchdog was not fed.
    Watchdog = 1,
    /// A panic, or a fault of the processor that is no stack overflow.
    Panic = 2,
    /// The supply sagged.
    BrownOut = 3,
    /// The reset pin.
    Pin = 4,
    /// Software asked for it.
    Software = 5,
    /// The stack left its memory.
    StackOverflow = 6,
}

/// The hardware's reset flags, whatever register they come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Flags {
    /// Independent or window watchdog.
    pub watchdog: bool,
    /// Software reset.
    pub software: bool,
    /// Power-on or brown-out.
    pub brown_out: bool,
    /// Reset pin.
    pub pin: bool,
}

/// Words in memory that survives a reset but not the loss of power.
pub const WORDS: usize = 4;

const MAGIC: u32 = u32::from_le_bytes(*b"last");

/// Left beside the crash record, and its complement behind it, where the chip's bootloader is to run after the reset.
pub const NEXT_BOOTLOADER: u32 = u32::from_le_bytes(*b"boot");

/// What is left there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CrashRecord {
    /// Set by whoever ends the program.
    pub reason: Option<Reason>,
    /// Number of the fault that was active, 0 for none.
    pub fault: u16,
    /// Starts since power came on.
    pub starts: u16,
}

impl CrashRecord {
    /// As words; the last one checks the others.
    pub const fn to_words(self) -> [u32; WORDS] {
        let reason = match self.reason {
            Some(reason) => reason as u32,
            None => 0xFF,
        };
        let counts = (self.fault as u32) << 16 | self.starts as u32;
        [MAGIC, reason, counts, !(MAGIC ^ reason ^ counts)]
    }

    /// From words; `None` for anything that [`CrashRecord::to_words`] did not write.
    pub fn from_words(words: [u32; WORDS]) -> Option<Self> {
        let [magic, reason, counts, check] = words;
        if magic != MAGIC || check != !(magic ^ reason ^ counts) {
            return None;
        }
        let reason = match reason {
            2 => Some(Reason::Panic),
            6 => Some(Reason::StackOverflow),
            5 => Some(Reason::Software),
            _ => None,
        };
        Some(Self {
            reason,
            fault: (counts >> 16) as u16,
            starts: counts as u16,
        })
    }
}

/// The reason to report: the crash record counts above the flags, and a watchdog above
/// the reset that software asked for.
pub fn reason(flags: Flags, last: Option<CrashRecord>) -> Reason {
    let recorded = last.and_then(|record| record.reason);
    match (flags, recorded) {
        // Memory that lost its power may hold anything, even a crash record.
        (
            Flags {
                brown_out: true, ..
            },
            _,
        ) if last.is_none() => Reason::PowerOn,
        (
            Flags {
                brown_out: true, ..
            },
            _,
        ) => Reason::BrownOut,
        (_, Some(reason)) => reason,
        (Flags { watchdog: true, .. }, None) => Reason::Watchdog,
        (Flags { software: true, .. }, None) => Reason::Software,
        (Flags { pin: true, .. }, None) => Reason::Pin,
        (_, None) => Reason::PowerOn,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PANICKED: CrashRecord = CrashRecord {
        reason: Some(Reason::Panic),
        fault: 4,
        starts: 3,
    };

    #[test]
    fn a_record_survives_and_noise_does_not_count() {
        let words = PANICKED.to_words();
        assert_eq!(CrashRecord::from_words(words), Some(PANICKED));
        for word in 0..WORDS {
            for bit in 0..32 {
                let mut damaged = words;
                damaged[word] ^= 1 << bit;
                assert_eq!(
                    CrashRecord::from_words(damaged),
                    None,
                    "word {word} bit {bit}"
                );
            }
        }
        assert_eq!(CrashRecord::from_words([0; WORDS]), None);
        assert_eq!(CrashRecord::from_words([u32::MAX; WORDS]), None);
    }

    #[test]
    fn each_reason_is_reported() {
        let none = Flags::default();
        let watchdog = Flags {
            watchdog: true,
            pin: true,
            ..none
        };
        let software = Flags {
            software: true,
            pin: true,
            ..none
        };
        let brown_out = Flags {
            brown_out: true,
            pin: true,
            ..none
        };
        let quiet = Some(CrashRecord::default());
        assert_eq!(reason(watchdog, quiet), Reason::Watchdog);
        assert_eq!(reason(software, quiet), Reason::Software);
        assert_eq!(reason(software, Some(PANICKED)), Reason::Panic);
        assert_eq!(reason(Flags { pin: true, ..none }, quiet), Reason::Pin);
        assert_eq!(reason(brown_out, None), Reason::PowerOn);
        assert_eq!(reason(brown_out, quiet), Reason::BrownOut);
        assert_eq!(reason(none, None), Reason::PowerOn);
    }
}
