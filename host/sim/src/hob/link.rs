//! Link of a simulated hob: bytes to and from the firmware, at the rate of the cable.

use ihd_shared::wire::frame::MAX_ENCODED;

use super::SimHob;

/// Capacity of a bounded link's buffer in bytes: about a window.
const LINK_BUFFER: usize = 64 * 1024;

impl SimHob {
    /// Passes waiting bytes to the firmware, and takes as many from it as the cable carries in `elapsed_s`.
    pub(super) fn run_link(&mut self, elapsed_s: f64) {
        let bytes = self.inbound.make_contiguous();
        self.housekeeping.receive(&mut *self.sampling_path, bytes);
        self.inbound.clear();
        // An idle link accumulates credit for one frame only.
        self.link_credit =
            (self.link_credit + elapsed_s * self.link_bytes_per_s).min(MAX_ENCODED as f64);
        let mut frame = [0; MAX_ENCODED];
        while self.link_credit > 0.0 && self.outbound.len() < self.outbound_room {
            let n = self
                .housekeeping
                .transmit(&mut *self.sampling_path, &mut frame);
            if n == 0 {
                break;
            }
            self.link_credit -= n as f64;
            self.outbound.extend(&frame[..n]);
        }
    }

    /// Passes bytes from the host.
    pub fn send(&mut self, bytes: &[u8]) {
        self.inbound.extend(bytes);
    }

    /// Takes bytes for the host; returns how many.
    pub fn receive(&mut self, buf: &mut [u8]) -> usize {
        let n = buf.len().min(self.outbound.len());
        for (slot, byte) in buf.iter_mut().zip(self.outbound.drain(..n)) {
            *slot = byte;
        }
        n
    }

    /// Bounds the link's buffer: like a board whose endpoint is not read, the firmware then waits for the link, and drops and
    /// counts what it has no room for.
    pub fn bound_link(&mut self) {
        self.outbound_room = LINK_BUFFER;
    }

    /// Number of bytes from the host that the firmware has not read yet: it reads after each block.
    pub fn unread(&self) -> usize {
        self.inbound.len()
    }

    /// Number of bytes that wait for the host.
    pub fn waiting(&self) -> usize {
        self.outbound.len()
    }
}
