//! The link over LPUART1, which is the ST-LINK's serial port on a NUCLEO-G474RE.
//!
//! 921 600 baud carry 92 kB/s: telemetry of every half-cycle takes 5 kB/s, a window of 12 200 pairs
//! and its trajectory 51 kB, so a window every second fits with room for commands; every tenth of a
//! second does not.

use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embedded_io_async::{Read, Write};

use crate::board::link::{Receive, Send};

/// Bits per second.
pub const BAUD: u32 = 921_600;

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
    async fn send(&mut self, bytes: &[u8]) -> usize {
        self.0.write(bytes).await.unwrap_or(0)
    }
}
