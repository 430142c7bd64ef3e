//! Non-volatile pages: the last good lookup, kept through the loss of power in two pages of flash, of
//! which one is always whole.
//!
//! ```text
//! record: sequence u32 · !sequence u32 · lookup (its own CRC-32 at the end) · padding to 8 bytes
//! ```
//!
//! A save erases the older page, writes the lookup, and its sequence last. Wherever the power goes,
//! the other page still holds what it held.

use core::future::Future;

use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::blob::LEN;

/// Bytes that the flash writes at a time.
pub const WORD: usize = 8;

/// Bytes of a record, at the beginning of its page.
pub const RECORD_BYTES: usize = WORD + LEN.div_ceil(WORD) * WORD;

/// Two pages of at least [`RECORD_BYTES`], each erased on its own.
pub trait Flash {
    /// Error that the hardware reports.
    type Error;
    /// Reads a page's record.
    fn read(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]);
    /// Sets every bit of a page. Takes tens of milliseconds, in which others run.
    ///
    /// # Errors
    /// Error of the hardware.
    fn erase(&mut self, page: usize) -> impl Future<Output = Result<(), Self::Error>>;
    /// Writes whole words at an offset that is one's multiple, once after each erasure.
    ///
    /// # Errors
    /// Error of the hardware.
    fn write(
        &mut self,
        page: usize,
        offset: usize,
        bytes: &[u8],
    ) -> impl Future<Output = Result<(), Self::Error>>;
}

/// Reason that a lookup was not kept. The one kept before is still there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SaveError<E> {
    /// Error that the hardware reports.
    Flash(E),
    /// It reported nothing, but the page does not hold what was written.
    NotThere,
}

/// Sequence and lookup of a page; `None` if it is not whole.
fn read<F: Flash>(flash: &mut F, page: usize) -> Option<(u32, RlLookup)> {
    let mut bytes = [0; RECORD_BYTES];
    flash.read(page, &mut bytes);
    let [a, b, c, d, e, f, g, h, rest @ ..] = &bytes;
    let sequence = u32::from_le_bytes([*a, *b, *c, *d]);
    if u32::from_le_bytes([*e, *f, *g, *h]) != !sequence {
        return None;
    }
    let lookup = RlLookup::from_bytes(rest.get(..LEN)?).ok()?;
    Some((sequence, lookup))
}

/// Place of the newest whole record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RecordPlace {
    page: usize,
    sequence: u32,
}

/// Returns the last good lookup, checked as if it came over the link, and its place. To be called before the bridge may switch: a
/// damaged page opens it (SYSCFG, SYSCFG_CFGR2: ECCL).
pub fn load<F: Flash>(flash: &mut F) -> Option<(RecordPlace, RlLookup)> {
    let (page, (sequence, lookup)) = match (read(flash, 0), read(flash, 1)) {
        (Some(a), Some(b)) if a.0.wrapping_sub(b.0) < 1 << 31 => (0, a),
        (_, Some(b)) => (1, b),
        (Some(a), None) => (0, a),
        (None, None) => return None,
    };
    Some((RecordPlace { page, sequence }, lookup))
}

/// A lookup's record; [`save`] adds the sequence.
pub fn record_of(lookup: &RlLookup) -> [u8; RECORD_BYTES] {
    let mut record = [0xFF; RECORD_BYTES];
    record[WORD..][..LEN].copy_from_slice(&lookup.to_bytes());
    record
}

/// Keeps a record beside the one at `newest`, and reads it back: embassy-stm32's asynchronous driver clears an error before it
/// reads it. No other page is read.
///
/// # Errors
/// [`SaveError`]; the lookup kept before is still there, and `newest` its place.
pub async fn save<F: Flash>(
    flash: &mut F,
    newest: &mut Option<RecordPlace>,
    record: &mut [u8; RECORD_BYTES],
) -> Result<(), SaveError<F::Error>> {
    let (page, sequence) = match newest {
        Some(newest) => (1 - newest.page, newest.sequence.wrapping_add(1)),
        None => (0, 0),
    };
    let (head, rest) = record.split_at_mut(WORD);
    head[..4].copy_from_slice(&sequence.to_le_bytes());
    head[4..].copy_from_slice(&(!sequence).to_le_bytes());
    flash.erase(page).await.map_err(SaveError::Flash)?;
    flash
        .write(page, WORD, rest)
        .await
        .map_err(SaveError::Flash)?;
    flash.write(page, 0, head).await.map_err(SaveError::Flash)?;
    let mut kept = [0; RECORD_BYTES];
    flash.read(page, &mut kept);
    if kept != *record {
        return Err(SaveError::NotThere);
    }
    *newest = Some(RecordPlace { page, sequence });
    Ok(())
}

#[cfg(test)]
mod tests {
    use core::pin::pin;
    use core::task::{Context, Poll, Waker};

    use super::*;
    use ihd_shared::lookup::prior::prior;

    /// Flash whose power goes after some words; what is being erased or written then is damaged.
    struct CutFlash {
        pages: [[u8; RECORD_BYTES]; 2],
        words_left: usize,
    }

    #[derive(Debug, PartialEq)]
    struct PowerGone;

    impl CutFlash {
        fn spend(&mut self) -> Result<(), PowerGone> {
            self.words_left = self.words_left.checked_sub(1).ok_or(PowerGone)?;
            Ok(())
        }
    }

    impl Flash for CutFlash {
        type Error = PowerGone;
        fn read(&mut self, page: usize, out: &mut [u8; RECORD_BYTES]) {
            *out = self.pages[page];
        }
        async fn erase(&mut self, page: usize) -> Result<(), PowerGone> {
            for word in 0..RECORD_BYTES / WORD {
                if self.spend().is_err() {
                    // Half erased: some bits set, some not.
                    self.pages[page][word * WORD] |= 0xA5;
                    return Err(PowerGone);
                }
                self.pages[page][word * WORD..][..WORD].fill(0xFF);
            }
            Ok(())
        }
        async fn write(
            &mut self,
            page: usize,
            offset: usize,
            bytes: &[u8],
        ) -> Result<(), PowerGone> {
            for (k, word) in bytes.chunks(WORD).enumerate() {
                let place = &mut self.pages[page][offset + k * WORD..][..WORD];
                assert!(place.iter().all(|&b| b == 0xFF), "written twice");
                place[..WORD / 2].copy_from_slice(&word[..WORD / 2]);
                self.spend()?;
                self.pages[page][offset + k * WORD..][..WORD].copy_from_slice(word);
            }
            Ok(())
        }
    }

    /// Saves as after a start; this flash never waits.
    fn save<F: Flash>(flash: &mut F, lookup: &RlLookup) -> Result<(), SaveError<F::Error>> {
        let mut newest = super::load(flash).map(|(place, _)| place);
        save_beside(flash, &mut newest, lookup)
    }

    fn save_beside<F: Flash>(
        flash: &mut F,
        newest: &mut Option<RecordPlace>,
        lookup: &RlLookup,
    ) -> Result<(), SaveError<F::Error>> {
        let mut record = record_of(lookup);
        let saving = pin!(super::save(flash, newest, &mut record));
        match saving.poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(saved) => saved,
            Poll::Pending => unreachable!("it never waits"),
        }
    }

    fn load<F: Flash>(flash: &mut F) -> Option<RlLookup> {
        super::load(flash).map(|(_, lookup)| lookup)
    }

    fn lookup(version: u32) -> RlLookup {
        RlLookup { version, ..prior() }
    }

    fn blank() -> CutFlash {
        CutFlash {
            pages: [[0xFF; RECORD_BYTES]; 2],
            words_left: usize::MAX,
        }
    }

    #[test]
    fn what_is_saved_is_loaded() {
        let mut flash = blank();
        assert_eq!(load(&mut flash), None);
        for version in 1..6 {
            save(&mut flash, &lookup(version)).unwrap();
            assert_eq!(load(&mut flash), Some(lookup(version)));
        }
    }

    #[test]
    fn a_cut_at_any_word_leaves_the_old_or_the_new() {
        let words = 2 * RECORD_BYTES / WORD;
        let mut kept = [0; 3];
        for cut in 0..=words {
            let mut flash = blank();
            save(&mut flash, &lookup(1)).unwrap();
            save(&mut flash, &lookup(2)).unwrap();
            flash.words_left = cut;
            let saved = save(&mut flash, &lookup(3));
            flash.words_left = usize::MAX;
            let version = load(&mut flash).expect("one of them").version;
            assert_eq!(saved.is_ok(), cut == words, "cut after {cut} of {words}");
            assert!(
                version == 3 || (version == 2 && saved.is_err()),
                "{version}"
            );
            kept[version as usize - 1] += 1;
            // And it goes on from there.
            save(&mut flash, &lookup(4)).unwrap();
            assert_eq!(load(&mut flash), Some(lookup(4)));
        }
        assert_eq!((kept[0], kept[2]), (0, 1));
    }

    /// A running program reads no page but the one that it has just written: the other may be damaged.
    #[test]
    fn saves_without_a_restart_alternate_and_a_failed_one_is_repeated_in_its_page() {
        let (mut flash, mut newest) = (blank(), None);
        for version in 1..4 {
            save_beside(&mut flash, &mut newest, &lookup(version)).unwrap();
            assert_eq!(load(&mut flash), Some(lookup(version)));
        }
        let before = newest;
        flash.words_left = 3;
        save_beside(&mut flash, &mut newest, &lookup(4)).unwrap_err();
        flash.words_left = usize::MAX;
        assert_eq!((newest, load(&mut flash)), (before, Some(lookup(3))));
        save_beside(&mut flash, &mut newest, &lookup(5)).unwrap();
        assert_eq!(load(&mut flash), Some(lookup(5)));
    }

    /// Flash that takes everything and keeps nothing, in silence.
    struct DeafFlash;

    impl Flash for DeafFlash {
        type Error = PowerGone;
        fn read(&mut self, _: usize, out: &mut [u8; RECORD_BYTES]) {
            out.fill(0xFF);
        }
        async fn erase(&mut self, _: usize) -> Result<(), PowerGone> {
            Ok(())
        }
        async fn write(&mut self, _: usize, _: usize, _: &[u8]) -> Result<(), PowerGone> {
            Ok(())
        }
    }

    #[test]
    fn what_is_not_there_afterwards_was_not_kept() {
        assert_eq!(save(&mut DeafFlash, &lookup(1)), Err(SaveError::NotThere));
    }

    #[test]
    fn the_sequence_may_wrap() {
        let mut flash = blank();
        for (page, sequence) in [(0, u32::MAX), (1, 0u32)] {
            let bytes = &mut flash.pages[page];
            bytes[..4].copy_from_slice(&sequence.to_le_bytes());
            bytes[4..8].copy_from_slice(&(!sequence).to_le_bytes());
            bytes[8..8 + LEN].copy_from_slice(&lookup(page as u32 + 1).to_bytes());
        }
        assert_eq!(load(&mut flash), Some(lookup(2)));
    }

    #[test]
    fn a_damaged_lookup_is_not_loaded() {
        let mut flash = blank();
        save(&mut flash, &lookup(1)).unwrap();
        flash.pages[0][100] ^= 1;
        assert_eq!(load(&mut flash), None);
    }
}
