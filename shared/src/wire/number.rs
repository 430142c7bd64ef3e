//! The numbers of requests, by which an answer finds the request that it is for.

/// Number of a request, counted by the host from [`Number::FIRST`] on. Its answer repeats it, and so does the request when
/// it is sent again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Number(u16);

impl Number {
    /// Belongs to no request: before the first, and in answers to what had no number.
    pub const NONE: Self = Self(0);

    /// Number of the first request after a hello.
    pub const FIRST: Self = Self(1);

    /// Number as it travels, two bytes, the lower one first.
    pub const fn to_le_bytes(self) -> [u8; 2] {
        self.0.to_le_bytes()
    }

    /// Inverse of [`Number::to_le_bytes`].
    pub const fn from_le_bytes(bytes: [u8; 2]) -> Self {
        Self(u16::from_le_bytes(bytes))
    }

    /// Number of the request after this one; [`Number::NONE`] is left out.
    #[must_use]
    pub const fn next(self) -> Self {
        match self.0.wrapping_add(1) {
            0 => Self::FIRST,
            next => Self(next),
        }
    }

    /// Returns `true` if this is a later request's than `other`: fewer than half of all numbers lie between.
    pub const fn is_after(self, other: Self) -> bool {
        let ahead = self.0.wrapping_sub(other.0);
        ahead != 0 && ahead < 0x8000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_round_without_the_one_that_belongs_to_nobody() {
        let mut number = Number::NONE;
        for _ in 0..3 * 65_535u32 {
            let next = number.next();
            assert!(next.is_after(number) && !number.is_after(next));
            assert!(!next.is_after(next) && next != Number::NONE);
            assert_eq!(Number::from_le_bytes(next.to_le_bytes()), next);
            number = next;
        }
        assert_eq!(number, Number(65_535));
        assert_eq!(number.next(), Number::FIRST);
    }

    #[test]
    fn what_lies_half_the_range_behind_is_earlier() {
        let now = Number(20_000);
        for behind in [1, 1_000, 0x7FFF] {
            let earlier = Number(now.0.wrapping_sub(behind));
            assert!(now.is_after(earlier) && !earlier.is_after(now), "{behind}");
        }
    }
}
