//! CMSDK UART 0 (Arm DDI 0479, section 4.3) as the link's port. QEMU hands it a byte whenever its
//! receive register is free, so nothing is lost however slowly we read.

use core::future::poll_fn;
use core::ptr;
use core::task::Poll;

use cortex_m::peripheral::NVIC;
use embassy_sync::waitqueue::AtomicWaker;

use super::vectors::Interrupt;
use crate::board::link::{Receive, Send};

const DATA: *mut u32 = 0x4000_4000 as *mut u32;
const STATE: *mut u32 = 0x4000_4004 as *mut u32;
const CTRL: *mut u32 = 0x4000_4008 as *mut u32;
const INT_CLEAR: *mut u32 = 0x4000_400C as *mut u32;
const BAUD_DIV: *mut u32 = 0x4000_4010 as *mut u32;

const TX_FULL: u32 = 1 << 0;
const RX_FULL: u32 = 1 << 1;
const RX_INTERRUPT: u32 = 1 << 1;
/// Both directions on, interrupt on reception.
const ENABLE: u32 = 1 << 0 | 1 << 1 | 1 << 3;

static RECEIVED: AtomicWaker = AtomicWaker::new();

fn read(register: *mut u32) -> u32 {
    // SAFETY: the constants above are this UART's registers, always mapped; a read of any has no
    // effect but DATA's, which takes the byte that is read.
    unsafe { ptr::read_volatile(register) }
}

fn write(register: *mut u32, value: u32) {
    // SAFETY: as `read`; the UART touches no memory.
    unsafe { ptr::write_volatile(register, value) }
}

#[unsafe(no_mangle)]
extern "C" fn UART0_RECEIVE() {
    write(INT_CLEAR, RX_INTERRUPT);
    RECEIVED.wake();
}

/// The receiving half.
pub struct Receiver;

/// The sending half.
pub struct Sender;

/// Switches the UART on; receiver and sender.
pub fn start() -> (Receiver, Sender) {
    // The smallest divider; QEMU does not pace what it passes on.
    write(BAUD_DIV, 16);
    write(CTRL, ENABLE);
    // SAFETY: the handler above exists and takes no lock.
    unsafe { NVIC::unmask(Interrupt::Uart0Receive) };
    (Receiver, Sender)
}

impl Receive for Receiver {
    async fn receive(&mut self, buf: &mut [u8]) -> usize {
        poll_fn(|cx| {
            RECEIVED.register(cx.waker());
            let mut length = 0;
            for slot in buf.iter_mut() {
                if read(STATE) & RX_FULL == 0 {
                    break;
                }
                *slot = read(DATA) as u8;
                length += 1;
            }
            if length == 0 {
                Poll::Pending
            } else {
                Poll::Ready(length)
            }
        })
        .await
    }
}

impl Send for Sender {
    /// Waits for each byte's turn: QEMU takes one at once.
    async fn send(&mut self, bytes: &[u8]) -> usize {
        for &byte in bytes {
            while read(STATE) & TX_FULL != 0 {}
            write(DATA, u32::from(byte));
        }
        bytes.len()
    }
}
