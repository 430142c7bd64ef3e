//! Decoding of defmt's frames: reverse zero-compressing COBS, separated by zeros.

/// Error for bytes that are not a valid encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RzcobsError;

/// Decodes one frame, without the zero at its end. The result may end in up to six additional zeros: the encoding does not preserve
/// the length.
///
/// A byte encodes at most seven bytes, so the result has at most seven times the frame's length.
pub(crate) fn decode(frame: &[u8]) -> Result<Vec<u8>, RzcobsError> {
    let mut decoded = Vec::with_capacity(frame.len());
    // The codes follow the bytes that they describe.
    let mut rest = frame.iter().rev().copied();
    while let Some(code) = rest.next() {
        match code {
            0 => return Err(RzcobsError),
            // One bit for each of seven bytes, 1 for a zero byte.
            0x01..=0x7f => {
                for bit in (0..7).rev() {
                    let is_zero = code & (1 << bit) != 0;
                    decoded.push(if is_zero {
                        0
                    } else {
                        rest.next().ok_or(RzcobsError)?
                    });
                }
            }
            // A zero after 7 to 133 bytes.
            0x80..=0xfe => {
                decoded.push(0);
                for _ in 0..code - 0x80 + 7 {
                    decoded.push(rest.next().ok_or(RzcobsError)?);
                }
            }
            // 134 bytes without a zero.
            0xff => {
                for _ in 0..134 {
                    decoded.push(rest.next().ok_or(RzcobsError)?);
                }
            }
        }
    }
    decoded.reverse();
    Ok(decoded)
}

#[cfg(test)]
mod tests {
    use ihd_fakes::log::encode;
    use proptest::prelude::*;

    use super::*;

    /// Pairs of defmt's own tests of its encoder.
    #[test]
    fn what_defmt_encodes_is_decoded() {
        let run: Vec<u8> = (1..=134).collect();
        let pairs: [(&[u8], &[u8]); 7] = [
            (&[], &[]),
            (&[0], &[0x7f]),
            (&[1, 2], &[1, 2, 0x7c]),
            (&[1, 2, 3, 4, 5, 6, 0], &[1, 2, 3, 4, 5, 6, 0x40]),
            (&[1, 2, 3, 4, 5, 6, 7, 0], &[1, 2, 3, 4, 5, 6, 7, 0x80]),
            (
                &[0, 0, 0, 0, 0, 0x44, 0, 0, 0, 0, 0, 0, 0, 0xff],
                &[0x44, 0x5f, 0xff, 0x3f],
            ),
            (&run, &[&run[..], &[0xff]].concat()),
        ];
        for (plain, encoded) in pairs {
            let decoded = decode(encoded).unwrap();
            assert_eq!(decoded[..plain.len()], *plain);
            assert!(decoded[plain.len()..].iter().all(|&byte| byte == 0));
            assert_eq!(encode(plain), encoded);
        }
    }

    #[test]
    fn what_is_cut_off_is_refused() {
        for frame in [&[1, 0x80][..], &[0x01], &[0xff], &[1, 2, 3, 0xfe]] {
            assert_eq!(decode(frame), Err(RzcobsError), "{frame:?}");
        }
    }

    proptest! {
        #[test]
        fn what_was_encoded_comes_back(
            bytes in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 0..600)
        ) {
            let encoded = encode(&bytes);
            prop_assert!(!encoded.contains(&0));
            let decoded = decode(&encoded).unwrap();
            prop_assert_eq!(&decoded[..bytes.len()], &bytes[..]);
            prop_assert!(decoded[bytes.len()..].iter().all(|&byte| byte == 0));
            prop_assert!(decoded.len() - bytes.len() < 7);
        }

        #[test]
        fn any_bytes_end_in_bounded_memory(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            if let Ok(decoded) = decode(&bytes) {
                prop_assert!(decoded.len() <= 7 * bytes.len());
            }
        }
    }
}
