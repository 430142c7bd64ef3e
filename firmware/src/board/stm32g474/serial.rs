//! The link over LPUART1, which is the ST-LINK's serial port on a NUCLEO-G474RE.
//!
//! 921 600 baud carry 92 kB/s: telemetry of every half-cycle takes 5 kB/s, a window of 12 200 pairs
//! and its trajectory 51 kB, so a window every second fits with room for commands; every tenth of a
//! second does not.

use core::task::Poll;

use embassy_futures::poll_once;
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embedded_io_async::{Read, Write};

use crate::board::link::{Receive, Send};

/// Bytes that the driver takes at a time. Between two of them the line idles until the thread comes
/// by, which at the end of a block is tens of microseconds in 5.5 ms.
pub const TRANSMIT_BUFFER: usize = 512;

/// Bytes that may come in while the thread is busy: 2.8 ms of them.
pub const RECEIVE_BUFFER: usize = 256;

/// The receiving half.
pub struct Receiver(pub BufferedUartRx<'static>);

/// The sending half.
pub struct Sender(pub BufferedUartTx<'static>);

impl Receive for Receiver {
    async fn receive(&mut self, buf: &mut [u8]) -> usize {
        // A framing error or an overrun costs bytes, which the frames' CRC shows.
        self.0.read(buf).await.unwrap_or(0)
    }
}

impl Send for Sender {
    /// Waits until what was taken before has left, then takes what fits. The driver's own write
    /// refuses more than its buffer, and where there is too little room it returns without
    /// keeping the waker (embassy-stm32 0.6, usage of `tx_waker` in usart/buffered.rs); only its
    /// flush can be waited for. A dropped flush loses nothing, and the write is ready at the poll
    /// at which it takes the bytes, so none is lost and none sent twice.
    async fn send(&mut self, bytes: &[u8]) -> usize {
        let part = bytes.get(..TRANSMIT_BUFFER).unwrap_or(bytes);
        loop {
            if self.0.flush().await.is_err() {
                return 0;
            }
            // Not ready: flush returned at the buffer's wrap, with bytes behind it. Trying has
            // made the next flush wait for them.
            if let Poll::Ready(taken) = poll_once(self.0.write(part)) {
                return taken.unwrap_or(0);
            }
        }
    }
}
