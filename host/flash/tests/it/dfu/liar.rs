//! A device that answers anything.

use std::cell::Cell;
use std::time::Duration;

use dfu_core::functional_descriptor::FunctionalDescriptor;
use dfu_core::memory_layout::MemoryLayout;
use dfu_core::{DfuIo, DfuProtocol};
use ihd_flash::dfu::{BootloaderIo, TransferFailure};

/// Requests after which nobody may go on.
const ENOUGH: usize = 100_000;

/// The device: gives these answers in turn, an empty one is a STALL.
pub struct Liar {
    answers: Vec<Vec<u8>>,
    turn: Cell<usize>,
    descriptor: FunctionalDescriptor,
    protocol: DfuProtocol<MemoryLayout>,
    layouts: Vec<String>,
}

impl Liar {
    pub fn new(answers: Vec<Vec<u8>>, transfer_size: u16) -> Self {
        let layouts = [
            "@Internal Flash   /0x08000000/256*02Kg",
            "@Option Bytes   /0x1FFF7800/01*048 e/0x1FFFF800/01*048 e",
        ];
        Self {
            answers,
            turn: Cell::new(0),
            descriptor: FunctionalDescriptor {
                can_download: true,
                can_upload: true,
                manifestation_tolerant: false,
                will_detach: true,
                detach_timeout: 255,
                transfer_size,
                dfu_version: (1, 0x1A),
            },
            protocol: DfuProtocol::Dfu,
            layouts: layouts.map(str::to_owned).into(),
        }
    }

    fn next(&self) -> Result<&[u8], dfu_core::Error> {
        let turn = self.turn.get();
        assert!(turn < ENOUGH, "it goes on for ever");
        self.turn.set(turn + 1);
        match &self.answers[turn % self.answers.len()][..] {
            [] => Err(dfu_core::Error::OutOfCapabilities),
            answer => Ok(answer),
        }
    }
}

impl DfuIo for Liar {
    type Read = usize;
    type Write = usize;
    type Reset = ();
    type Error = dfu_core::Error;
    type MemoryLayout = MemoryLayout;

    fn read_control(
        &self,
        _request_type: u8,
        _request: u8,
        _value: u16,
        buffer: &mut [u8],
    ) -> Result<usize, dfu_core::Error> {
        let answer = self.next()?;
        let length = answer.len().min(buffer.len());
        buffer[..length].copy_from_slice(&answer[..length]);
        // Sometimes as much as was asked for.
        Ok(if answer[0] < 6 { buffer.len() } else { length })
    }

    fn write_control(
        &self,
        _request_type: u8,
        _request: u8,
        _value: u16,
        buffer: &[u8],
    ) -> Result<usize, dfu_core::Error> {
        self.next().map(|_| buffer.len())
    }

    fn usb_reset(self) -> Result<(), dfu_core::Error> {
        Ok(())
    }

    fn protocol(&self) -> &DfuProtocol<MemoryLayout> {
        &self.protocol
    }

    fn functional_descriptor(&self) -> &FunctionalDescriptor {
        &self.descriptor
    }
}

impl BootloaderIo for Liar {
    fn select(&self, _alternate: u8) -> Result<(), dfu_core::Error> {
        self.next().map(drop)
    }

    fn layouts(&self) -> &[String] {
        &self.layouts
    }

    fn serial(&self) -> &str {
        "\u{7}"
    }

    fn transfer_failure(error: dfu_core::Error) -> TransferFailure {
        match error {
            dfu_core::Error::OutOfCapabilities => TransferFailure::Stalled,
            error => TransferFailure::Failed(error.to_string()),
        }
    }

    fn wait(&self, _time: Duration) {}
}
