//! Power that a device took for a request.

use std::fmt;

/// A request of power, and what the device made of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GrantedPower {
    /// Requested power, in watt.
    pub asked_w: u16,
    /// Power that the device has as its request now, in watt: at most its rating.
    pub granted_w: u16,
}

impl GrantedPower {
    /// The request with the detail of its reply. Firmware before the detail answers 0.
    pub(crate) fn from_detail(asked_w: u16, detail: u32) -> Self {
        let granted_w = match u16::try_from(detail) {
            Ok(0) | Err(_) => asked_w,
            Ok(granted_w) => granted_w.min(asked_w),
        };
        Self { asked_w, granted_w }
    }

    /// Returns `true` if the device took less than was requested.
    pub fn is_reduced(self) -> bool {
        self.granted_w < self.asked_w
    }
}

impl fmt::Display for GrantedPower {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { asked_w, granted_w } = self;
        match self.is_reduced() {
            true => write!(
                f,
                "{asked_w} W asked, {granted_w} W is the most this hob gives"
            ),
            false => write!(f, "{asked_w} W asked for"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_detail_tells_the_power_that_was_taken() {
        let cases = [
            (1_500, 1_500, "1500 W asked for"),
            (
                3_000,
                1_800,
                "3000 W asked, 1800 W is the most this hob gives",
            ),
            // Older firmware, and a device that answers nonsense.
            (1_500, 0, "1500 W asked for"),
            (1_500, 1_800, "1500 W asked for"),
            (1_500, u32::MAX, "1500 W asked for"),
            (0, 0, "0 W asked for"),
        ];
        for (asked_w, detail, text) in cases {
            let granted = GrantedPower::from_detail(asked_w, detail);
            assert_eq!(granted.to_string(), text, "{asked_w} {detail}");
        }
    }
}
