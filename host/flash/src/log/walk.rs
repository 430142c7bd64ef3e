//! Check of a frame against its format strings before decoding: a device may send wrong lengths, which the decoder would trust.

use std::collections::BTreeMap;

use defmt_parser::{DisplayHint, Fragment, Parameter, ParserMode, Type, get_max_bitfield_range};

/// Limit of values in one frame, nested ones included.
const MAX_VALUES: u32 = 4096;

/// Limit of the nesting depth.
const MAX_DEPTH: u32 = 32;

/// Format string of the image.
#[derive(Clone, Debug)]
pub(super) struct Format {
    /// Text as in the source: `watchdog runs: {=u32} µs`.
    pub text: String,
    /// `true` if it is a whole message, not part of one.
    pub is_message: bool,
}

/// Format strings by index.
pub(super) type Formats = BTreeMap<u64, Format>;

/// Returns `true` if a frame matches its format strings, followed by at most six zeros, which the encoding adds.
pub(super) fn fits(formats: &Formats, timestamp: Option<&str>, frame: &[u8]) -> bool {
    let mut walk = Walk {
        formats,
        rest: frame,
        values: 0,
    };
    let walked = walk.message(timestamp);
    walked.is_some() && walk.rest.len() < 7 && walk.rest.iter().all(|&byte| byte == 0)
}

struct Walk<'a> {
    formats: &'a Formats,
    rest: &'a [u8],
    values: u32,
}

impl<'a> Walk<'a> {
    fn message(&mut self, timestamp: Option<&str>) -> Option<()> {
        let formats = self.formats;
        let index = self.number(2)?;
        if let Some(timestamp) = timestamp {
            self.values_of(timestamp, 0)?;
        }
        let format = formats.get(&index).filter(|format| format.is_message)?;
        self.values_of(&format.text, 0)
    }

    fn take(&mut self, bytes: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(bytes)?;
        self.rest = rest;
        Some(taken)
    }

    /// Reads a number of up to eight bytes, least significant first.
    fn number(&mut self, bytes: usize) -> Option<u64> {
        let number = self.take(bytes)?.iter().rev();
        Some(number.fold(0, |sum, &byte| sum << 8 | u64::from(byte)))
    }

    fn values_of(&mut self, format: &str, depth: u32) -> Option<()> {
        if depth > MAX_DEPTH {
            return None;
        }
        let types = types(format)?;
        types.iter().try_for_each(|of| self.value(of, depth))
    }

    fn value(&mut self, of: &Type, depth: u32) -> Option<()> {
        self.count(1)?;
        let bytes = match of {
            Type::Bool | Type::I8 | Type::U8 => 1,
            Type::I16 | Type::U16 | Type::IStr => 2,
            Type::I32 | Type::U32 | Type::Isize | Type::Usize | Type::F32 | Type::Char => 4,
            Type::I64 | Type::U64 | Type::F64 => 8,
            Type::I128 | Type::U128 => 16,
            Type::BitField(bits) => match bits.end.checked_sub(1)? / 8 - bits.start / 8 {
                0 => 1,
                1 => 2,
                2..=3 => 4,
                4..=7 => 8,
                _ => 16,
            },
            Type::U8Array(bytes) => *bytes,
            Type::Str | Type::U8Slice => usize::try_from(self.number(4)?).ok()?,
            Type::Debug | Type::Display => self.rest.iter().position(|&byte| byte == 0xff)? + 1,
            Type::Format => {
                let format = self.part()?;
                return self.variant_of(format, depth);
            }
            Type::FormatSlice => {
                let elements = self.number(4)?;
                return self.elements(elements, depth);
            }
            Type::FormatArray(elements) => return self.elements(*elements as u64, depth),
            Type::FormatSequence => {
                while self.rest.get(..2)? != [0, 0] {
                    let format = self.part()?;
                    self.count(1)?;
                    self.values_of(format, depth + 1)?;
                }
                2
            }
        };
        self.take(bytes).map(drop)
    }

    /// Reads an index and returns the format string of that number.
    fn part(&mut self) -> Option<&'a str> {
        let formats = self.formats;
        let format = formats.get(&self.number(2)?)?;
        (!format.is_message).then_some(format.text.as_str())
    }

    fn elements(&mut self, elements: u64, depth: u32) -> Option<()> {
        let format = self.part()?;
        self.count(elements)?;
        (0..elements).try_for_each(|_| self.variant_of(format, depth))
    }

    /// Returns the value's format, or for an enumeration the one of its variant: `Idle|Heating {=u16}`.
    fn variant_of(&mut self, format: &str, depth: u32) -> Option<()> {
        let Some(last) = format.matches('|').count().checked_sub(1) else {
            return self.values_of(format, depth + 1);
        };
        let variants = last + 1;
        let bytes = match variants {
            0..=0xff => 1,
            0x100..=0xffff => 2,
            _ => 4,
        };
        let variant = usize::try_from(self.number(bytes)?).ok()?;
        self.values_of(format.split('|').nth(variant)?, depth + 1)
    }

    fn count(&mut self, values: u64) -> Option<()> {
        let values = u32::try_from(values).ok()?;
        self.values = self.values.checked_add(values)?;
        (self.values <= MAX_VALUES).then_some(())
    }
}

/// Types of a format string's values in the order of the frame: by their number, each once, bit fields of one together.
fn types(format: &str) -> Option<Vec<Type>> {
    let fragments = defmt_parser::parse(format, ParserMode::ForwardsCompatible).ok()?;
    let mut by_number: BTreeMap<usize, Vec<Parameter>> = BTreeMap::new();
    for fragment in fragments {
        if let Fragment::Parameter(parameter) = fragment {
            // The formatter (cbor-edn 0.0.6) panics on an empty string of indefinite length, and recurses without limit.
            if parameter.hint == Some(DisplayHint::Cbor) {
                return None;
            }
            by_number
                .entry(parameter.index)
                .or_default()
                .push(parameter);
        }
    }
    let first = |all: Vec<Parameter>| {
        if !matches!(all.first()?.ty, Type::BitField(_)) {
            return all.into_iter().next().map(|parameter| parameter.ty);
        }
        let bits = all.iter().filter(|p| matches!(p.ty, Type::BitField(_)));
        get_max_bitfield_range(bits).map(|(start, end)| Type::BitField(start..end))
    };
    by_number.into_values().map(first).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn formats(texts: &[(u64, &str)]) -> Formats {
        let format = |&(index, text): &(u64, &str)| {
            let format = Format {
                text: text.to_owned(),
                is_message: index >= 100,
            };
            (index, format)
        };
        texts.iter().map(format).collect()
    }

    fn fits(text: &str, parts: &[(u64, &str)], values: &[u8]) -> bool {
        let formats = formats(&[parts, &[(100, text)]].concat());
        super::fits(&formats, None, &[&[100, 0], values].concat())
    }

    #[test]
    fn plain_values_take_their_bytes() {
        assert!(fits("{=u8} and {=u32}", &[], &[1, 2, 3, 4, 5]));
        assert!(fits("{=u8} and {=u32}", &[], &[1, 2, 3, 4, 5, 0, 0]));
        assert!(!fits("{=u8} and {=u32}", &[], &[1, 2, 3, 4]));
        assert!(!fits("{=u8} and {=u32}", &[], &[1, 2, 3, 4, 5, 6]));
        assert!(fits("{1=u8} and {0=u32}, {1=u8}", &[], &[1, 2, 3, 4, 5]));
        assert!(fits("{0=0..4} {0=4..9}", &[], &[0xff, 1]));
        assert!(fits("{=str}", &[], &[2, 0, 0, 0, b'a', b'b']));
        assert!(!fits("{=str}", &[], &[0xff, 0xff, 0xff, 0xff, b'a']));
    }

    #[test]
    fn a_count_that_is_a_lie_is_no_frame() {
        let unit = &[(1, "nothing to read")];
        assert!(fits("{=[?]}", unit, &[2, 0, 0, 0, 1, 0]));
        // Elements of no bytes: only the count bounds them.
        assert!(!fits("{=[?]}", unit, &[0xff, 0xff, 0xff, 0x7f, 1, 0]));
        assert!(!fits("{=[?]}", unit, &[1, 0x10, 0, 0, 1, 0]));
        let slices = &[(1, "{=[?]}"), (2, "")];
        let inner = [0xff, 0, 0, 0, 2, 0].repeat(255);
        let frame = [&[0xff, 0, 0, 0, 1, 0][..], &inner].concat();
        assert!(!fits("{=[?]}", slices, &frame));
    }

    #[test]
    fn enumerations_and_sequences_are_followed() {
        let parts = &[(1, "Idle|Heating {=u16}"), (2, "{=u8}")];
        assert!(fits("{=?}", parts, &[1, 0, 0]));
        assert!(fits("{=?}", parts, &[1, 0, 1, 7, 8]));
        assert!(!fits("{=?}", parts, &[1, 0, 2]));
        assert!(!fits("{=?}", parts, &[9, 0]));
        assert!(fits(
            "{=__internal_FormatSequence}",
            parts,
            &[2, 0, 5, 2, 0, 6, 0, 0]
        ));
        assert!(!fits("{=__internal_FormatSequence}", parts, &[2, 0, 5]));
    }

    #[test]
    fn values_in_each_other_without_end_are_no_frame() {
        let parts = &[(1, "{=?}")];
        assert!(!fits("{=?}", parts, &[1, 0].repeat(2_000)));
    }

    /// Found by fuzzing: 5F FF.
    #[test]
    fn what_the_decoder_would_panic_on_is_no_frame() {
        assert!(fits("{=[u8]:02x}", &[], &[2, 0, 0, 0, 0x5f, 0xff]));
        assert!(!fits("{=[u8]:cbor}", &[], &[2, 0, 0, 0, 0x5f, 0xff]));
    }

    #[test]
    fn a_part_is_no_message_and_a_message_no_part() {
        let formats = formats(&[(1, ""), (100, "{=?}"), (101, "")]);
        assert!(super::fits(&formats, None, &[101, 0]));
        assert!(!super::fits(&formats, None, &[1, 0]));
        assert!(!super::fits(&formats, None, &[100, 0, 101, 0]));
        assert!(!super::fits(&formats, None, &[]));
    }

    #[test]
    fn a_time_stamp_stands_before_the_values() {
        let formats = formats(&[(100, "{=u8}")]);
        assert!(super::fits(&formats, Some("{=u16:us}"), &[100, 0, 1, 2, 3]));
        assert!(!super::fits(&formats, Some("{=u16:us}"), &[100, 0, 1, 2]));
    }
}
