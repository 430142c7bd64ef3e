//! Reason of the last reset: the hardware's flags, and the crash record in memory that a reset
//! does not clear.

use ihd_shared::fault::{Fault, RestartClass};

use crate::retained::control::RetainedControl;

/// Reason in [`ihd_shared::wire::messages::Hello::reset_reason`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum ResetReason {
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
    /// Software reset.
    Software = 5,
    /// The stack left its memory.
    StackOverflow = 6,
}

/// The hardware's reset flags, whatever register they come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ResetFlags {
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

/// Ends in a row after which the program stays stopped: each was reported, and another would be the same.
pub const MAX_ENDS: u32 = 4;

/// Blocks after which a start was a good one, and the ends before it no longer count: 1.2 s at 80 kHz, 2.9 s at 34 kHz.
pub const GOOD_START_BLOCKS: u32 = 32_768;

const MAGIC: u32 = u32::from_le_bytes(*b"last");

/// Left beside the crash record, and its complement behind it, where the chip's bootloader is to run after the reset.
pub const NEXT_BOOTLOADER: u32 = u32::from_le_bytes(*b"boot");

/// Record of the end of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CrashRecord {
    /// Reason of the end, set by the handler that ends the program.
    pub reason: Option<ResetReason>,
    /// Number of the fault that was active, 0 for none.
    pub fault: u16,
    /// Starts since power came on.
    pub starts: u16,
    /// Lock-out and panel, as they were last.
    pub control: RetainedControl,
}

impl CrashRecord {
    /// Encodes as words; the last one checks the others.
    pub const fn to_words(self) -> [u32; WORDS] {
        let reason = match self.reason {
            Some(reason) => reason as u32,
            None => 0xFF,
        };
        let [a, b, c] = self.control.to_bytes();
        let reason = reason | u32::from_le_bytes([0, a, b, c]);
        let counts = (self.fault as u32) << 16 | self.starts as u32;
        [MAGIC, reason, counts, !(MAGIC ^ reason ^ counts)]
    }

    /// The record in these words; `None` for anything that [`CrashRecord::to_words`] did not write.
    pub fn from_words(words: [u32; WORDS]) -> Option<Self> {
        let [magic, reason, counts, check] = words;
        if magic != MAGIC || check != !(magic ^ reason ^ counts) {
            return None;
        }
        let [_, a, b, c] = reason.to_le_bytes();
        let control = RetainedControl::from_bytes([a, b, c]);
        let reason = match reason & 0xFF {
            2 => Some(ResetReason::Panic),
            6 => Some(ResetReason::StackOverflow),
            5 => Some(ResetReason::Software),
            _ => None,
        };
        Some(Self {
            reason,
            fault: (counts >> 16) as u16,
            starts: counts as u16,
            control,
        })
    }

    /// Returns the state with which control begins after `last`: a loss of power that the RAM does not outlast ends a lock-out, no reset
    /// does, that of a sagging supply included. A fault of the controller itself that ended a run locks out, even if control could not
    /// record it.
    pub fn kept_control(last: Option<Self>) -> (RetainedControl, Fault) {
        let Some(last) = last else {
            return (RetainedControl::default(), Fault::NONE);
        };
        let fault = Fault::from_number(last.fault);
        let control = RetainedControl {
            locked_out: last.control.locked_out || fault.class() == RestartClass::Standing,
            ..last.control
        };
        (control, fault)
    }

    /// The record of the run that begins after `last`: whatever ends it before control has begun, a lock-out stays.
    pub fn begun(last: Option<Self>) -> Self {
        let (control, fault) = Self::kept_control(last);
        Self {
            reason: None,
            fault: if control.locked_out {
                fault.number()
            } else {
                0
            },
            starts: last.map_or(0, |record| record.starts.wrapping_add(1)),
            control,
        }
    }
}

/// The reason to report: the crash record counts above the flags, and a watchdog above
/// the reset by software.
pub fn reason(flags: ResetFlags, last: Option<CrashRecord>) -> ResetReason {
    let recorded = last.and_then(|record| record.reason);
    match (flags, recorded) {
        // Memory that lost its power may hold anything, even a crash record.
        (
            ResetFlags {
                brown_out: true, ..
            },
            _,
        ) if last.is_none() => ResetReason::PowerOn,
        (
            ResetFlags {
                brown_out: true, ..
            },
            _,
        ) => ResetReason::BrownOut,
        (_, Some(reason)) => reason,
        (ResetFlags { watchdog: true, .. }, None) => ResetReason::Watchdog,
        (ResetFlags { software: true, .. }, None) => ResetReason::Software,
        (ResetFlags { pin: true, .. }, None) => ResetReason::Pin,
        (_, None) => ResetReason::PowerOn,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retained::control::PanelSetting;

    const PANICKED: CrashRecord = CrashRecord {
        reason: Some(ResetReason::Panic),
        fault: 4,
        starts: 3,
        control: RetainedControl {
            locked_out: true,
            tries_used: 3,
            panel: PanelSetting::OFF,
            key_locked: false,
            unattended: 200,
        },
    };

    #[test]
    fn a_lock_out_outlasts_every_reset_but_the_loss_of_the_ram() {
        // However often: each run's record is what the next one finds.
        let mut last = Some(PANICKED);
        for _ in 0..3 {
            let (kept, fault) = CrashRecord::kept_control(last);
            assert_eq!((kept, fault.number()), (PANICKED.control, 4));
            last = CrashRecord::from_words(CrashRecord::begun(last).to_words());
        }
        let begun = (RetainedControl::default(), Fault::NONE);
        assert_eq!(CrashRecord::kept_control(None), begun);
        // A word of flash with two wrong bits: no code ran after it.
        let damaged = CrashRecord {
            fault: Fault::FLASH_ECC.number(),
            ..CrashRecord::default()
        };
        assert!(CrashRecord::kept_control(Some(damaged)).0.locked_out);
        // A fault of the mains passes.
        let mains = CrashRecord {
            fault: Fault::MAINS_LOST.number(),
            ..CrashRecord::default()
        };
        assert!(!CrashRecord::kept_control(Some(mains)).0.locked_out);
        assert_eq!(CrashRecord::begun(Some(mains)).fault, 0);
    }

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
        let none = ResetFlags::default();
        let watchdog = ResetFlags {
            watchdog: true,
            pin: true,
            ..none
        };
        let software = ResetFlags {
            software: true,
            pin: true,
            ..none
        };
        let brown_out = ResetFlags {
            brown_out: true,
            pin: true,
            ..none
        };
        let quiet = Some(CrashRecord::default());
        assert_eq!(reason(watchdog, quiet), ResetReason::Watchdog);
        assert_eq!(reason(software, quiet), ResetReason::Software);
        assert_eq!(reason(software, Some(PANICKED)), ResetReason::Panic);
        assert_eq!(
            reason(ResetFlags { pin: true, ..none }, quiet),
            ResetReason::Pin
        );
        assert_eq!(reason(brown_out, None), ResetReason::PowerOn);
        assert_eq!(reason(brown_out, quiet), ResetReason::BrownOut);
        assert_eq!(reason(none, None), ResetReason::PowerOn);
    }
}
