//! The clocks counted against each other, for a host that asks: the low-speed oscillator by what TIM16 captures, a USB
//! host's frames by their number, HSI48 by what CRS found.

use ihd_firmware::self_test::clock::{COUNTS_PER_S, ClockCapture, PERIODS};
use ihd_shared::wire::messages::Clocks;

use super::registers::clocks::{CORE_MHZ, hsi48};
use super::registers::usb_frame;

/// Duration of the count: 0.5 s.
const COUNTED_CYCLES: u32 = CORE_MHZ * 500_000;

/// Cycles of the main clock to one of the timer that captures.
const CYCLES_PER_COUNT: u32 = CORE_MHZ * 1_000_000 / COUNTS_PER_S;

/// Frame numbers of USB have 11 bits.
const FRAME_MASK: u16 = 0x7FF;

/// Counts so far.
pub struct ClockCount {
    began: u32,
    /// The last capture, while none was overtaken since.
    last: Option<u16>,
    periods: u32,
    counts: u32,
    /// The frame's number at the beginning, until it changes.
    frame: u16,
    /// The first change: number and cycle counter.
    first: Option<(u16, u32)>,
    /// The last change so far.
    latest: (u16, u32),
}

impl ClockCount {
    /// Begins to count now.
    pub fn begin(now: u32) -> Self {
        let frame = usb_frame::number();
        Self {
            began: now,
            last: None,
            periods: 0,
            counts: 0,
            frame,
            first: None,
            latest: (frame, now),
        }
    }

    /// Takes what has been captured and the frame's number, once a block.
    pub fn take(&mut self, captured: ClockCapture, now: u32) {
        match (captured, self.last) {
            (ClockCapture::At(at), Some(last)) => {
                self.periods += PERIODS;
                self.counts += u32::from(at.wrapping_sub(last));
                self.last = Some(at);
            }
            (ClockCapture::At(at), None) => self.last = Some(at),
            (ClockCapture::Overtaken, _) => self.last = None,
            (ClockCapture::Nothing, _) => {}
        }
        let frame = usb_frame::number();
        if frame != self.frame {
            self.frame = frame;
            self.first.get_or_insert((frame, now));
            self.latest = (frame, now);
        }
    }

    /// Result, once the count has lasted.
    pub fn result(&self, now: u32) -> Option<Clocks> {
        if now.wrapping_sub(self.began) < COUNTED_CYCLES {
            return None;
        }
        let (from, to) = (self.first.unwrap_or(self.latest), self.latest);
        let usb_frames = to.0.wrapping_sub(from.0) & FRAME_MASK;
        let (off, trim) = hsi48();
        Some(Clocks {
            main_hz: CORE_MHZ * 1_000_000,
            lsi_periods: self.periods,
            lsi_main_cycles: self.counts * CYCLES_PER_COUNT,
            usb_frames,
            usb_main_cycles: to.1.wrapping_sub(from.1),
            hsi48_off: if usb_frames > 0 { off } else { 0 },
            hsi48_trim: trim,
        })
    }
}
