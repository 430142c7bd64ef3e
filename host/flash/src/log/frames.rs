//! Split of a stream of log bytes into frames, for any input.

/// Limit of a frame in bytes: four times the device's whole buffer. Longer ones are invalid.
pub const MAX_FRAME: usize = 4096;

/// Bytes between two zeros.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFrame<'a> {
    /// Encoded frame, without its zero.
    Frame(&'a [u8]),
    /// Frame of more than [`MAX_FRAME`] bytes, which were dropped.
    Overlong,
}

/// Splitter; it buffers at most [`MAX_FRAME`] bytes since the last zero.
#[derive(Debug, Default)]
pub struct LogFrames {
    begun: Vec<u8>,
    overlong: bool,
    /// Set if the beginning of the current frame is missing: the bytes up to the next zero are dropped.
    headless: bool,
}

impl LogFrames {
    /// Splits bytes and passes each completed frame to `each`.
    pub fn push(&mut self, bytes: &[u8], mut each: impl FnMut(LogFrame<'_>)) {
        let mut rest = bytes;
        while let Some(end) = rest.iter().position(|&byte| byte == 0) {
            let (stretch, behind) = rest.split_at(end);
            rest = behind.get(1..).unwrap_or_default();
            self.append(stretch);
            if self.overlong {
                each(LogFrame::Overlong);
            } else if !self.begun.is_empty() && !self.headless {
                each(LogFrame::Frame(&self.begun));
            }
            self.begun.clear();
            (self.overlong, self.headless) = (false, false);
        }
        self.append(rest);
    }

    /// Reports missing bytes: the frame under way is dropped. `whole` is `true` if whole frames are missing, so the next byte
    /// begins one.
    pub fn gap(&mut self, whole: bool) {
        self.begun.clear();
        self.overlong = false;
        self.headless = !whole;
    }

    fn append(&mut self, bytes: &[u8]) {
        if self.begun.len() + bytes.len() > MAX_FRAME {
            self.overlong = true;
            self.begun.clear();
        }
        if !self.overlong {
            self.begun.extend_from_slice(bytes);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn all(chunks: &[&[u8]]) -> Vec<Option<Vec<u8>>> {
        let mut frames = LogFrames::default();
        let mut found = Vec::new();
        for chunk in chunks {
            frames.push(chunk, |stretch| {
                found.push(match stretch {
                    LogFrame::Frame(bytes) => Some(bytes.to_vec()),
                    LogFrame::Overlong => None,
                });
            });
        }
        found
    }

    #[test]
    fn zeros_cut_wherever_chunks_end() {
        let frames = all(&[&[0, 1, 2], &[3, 0, 0], &[4], &[0, 5]]);
        assert_eq!(frames, [Some(vec![1, 2, 3]), Some(vec![4])]);
    }

    #[test]
    fn a_frame_without_end_is_counted_once_and_takes_no_memory() {
        let mut frames = LogFrames::default();
        let mut overlong = 0;
        for _ in 0..1_000 {
            frames.push(&[7; 1_000], |_| overlong += 1);
        }
        assert_eq!(overlong, 0);
        assert!(frames.begun.capacity() <= 2 * MAX_FRAME);
        let mut found = Vec::new();
        frames.push(&[0, 8, 0], |stretch| found.push(format!("{stretch:?}")));
        assert_eq!(found, ["Overlong", "Frame([8])"]);
    }

    #[test]
    fn the_longest_frame_is_taken_and_one_byte_more_is_not() {
        let longest = [vec![1; MAX_FRAME], vec![0]].concat();
        assert_eq!(all(&[&longest])[0].as_ref().unwrap().len(), MAX_FRAME);
        assert_eq!(all(&[&[1], &longest]), [None]);
    }

    #[test]
    fn behind_a_gap_in_the_middle_of_a_frame_the_next_zero_comes_first() {
        for (whole, expected) in [(true, vec![vec![2], vec![3]]), (false, vec![vec![3]])] {
            let mut frames = LogFrames::default();
            let mut found = Vec::new();
            frames.push(&[1], |_| ());
            frames.gap(whole);
            frames.push(&[2, 0, 3, 0], |stretch| {
                if let LogFrame::Frame(bytes) = stretch {
                    found.push(bytes.to_vec());
                }
            });
            assert_eq!(found, expected);
        }
    }

    proptest! {
        #[test]
        fn chunks_make_no_difference(
            bytes in prop::collection::vec(0u8..3, 0..200),
            cuts in prop::collection::vec(1usize..9, 1..200)
        ) {
            let mut chunks: Vec<&[u8]> = Vec::new();
            let mut rest = &bytes[..];
            for cut in cuts {
                let (chunk, behind) = rest.split_at(cut.min(rest.len()));
                chunks.push(chunk);
                rest = behind;
            }
            chunks.push(rest);
            prop_assert_eq!(all(&chunks), all(&[&bytes]));
        }
    }
}
