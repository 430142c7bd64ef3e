use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::bootloader::State;
use super::chip::{FLASH, OPTIONS, PAGE};
use super::*;

const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const GETSTATUS: u8 = 3;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;

/// A host that does as the standard says, on time of its own.
struct Desk {
    device: Bootloader,
    now_ms: Arc<AtomicU64>,
}

impl Desk {
    fn new() -> Self {
        let now_ms = Arc::<AtomicU64>::default();
        let clock = Arc::clone(&now_ms);
        let now = move || Duration::from_millis(clock.load(Ordering::Relaxed));
        Self {
            device: Bootloader::new(Chip::default(), now),
            now_ms,
        }
    }

    /// Status and state after the operation, having waited as long as asked.
    fn command(&mut self, block: u16, data: &[u8]) -> Result<(u8, u8), Refused> {
        self.device.class_out(DNLOAD, block, data)?;
        loop {
            let told = self.device.class_in(GETSTATUS, 0, 6)?;
            if told[4] != State::DownloadBusy as u8 {
                return Ok((told[0], told[4]));
            }
            let wait = u64::from(told[1]) + (u64::from(told[2]) << 8);
            self.now_ms.fetch_add(wait, Ordering::Relaxed);
        }
    }

    fn address(&mut self, address: u32) {
        let bytes = [&[0x21][..], &address.to_le_bytes()].concat();
        assert_eq!(self.command(0, &bytes), Ok((0, State::DownloadIdle as u8)));
    }

    fn erase(&mut self, address: u32) -> (u8, u8) {
        let bytes = [&[0x41][..], &address.to_le_bytes()].concat();
        self.command(0, &bytes).unwrap()
    }
}

const DONE: (u8, u8) = (0, State::DownloadIdle as u8);

#[test]
fn a_page_is_erased_written_and_read_back() {
    let mut desk = Desk::new();
    desk.device.chip.flash.fill(0);
    assert_eq!(desk.erase(FLASH + PAGE as u32 + 5), DONE);
    desk.address(FLASH + PAGE as u32);
    assert_eq!(desk.command(2, &[1; 1024]), Ok(DONE));
    // The second block of 512 bytes lies behind the first.
    assert_eq!(desk.command(4, &[2; 512]), Ok(DONE));
    let flash = &desk.device.chip.flash;
    assert_eq!(flash[PAGE - 1], 0);
    assert_eq!(flash[PAGE..PAGE + 1024], [1; 1024]);
    assert_eq!(flash[PAGE + 1024..PAGE + 1536], [2; 512]);
    assert_eq!(flash[PAGE + 1536..2 * PAGE], [0xFF; 512]);
    // UPLOAD is not for dfuDNLOAD-IDLE.
    assert_eq!(desk.device.class_in(UPLOAD, 2, 16), Err(Refused::Stall));
    desk.device.class_out(CLRSTATUS, 0, &[]).unwrap();
    let read = desk.device.class_in(UPLOAD, 3, 1024).unwrap();
    assert_eq!(read[..512], [2; 512]);
    assert_eq!(desk.device.early, 0);
}

#[test]
fn what_is_not_erased_or_protected_is_not_written() {
    let mut desk = Desk::new();
    desk.address(FLASH);
    assert_eq!(desk.command(2, &[1; 8]), Ok(DONE));
    assert_eq!(
        desk.command(2, &[2; 8]).unwrap(),
        (Status::ErrProg as u8, 10)
    );
    assert_eq!(
        desk.device.class_out(DNLOAD, 2, &[2; 8]),
        Err(Refused::Stall)
    );
    desk.device.class_out(CLRSTATUS, 0, &[]).unwrap();
    // Pages 0 to 3 of the first bank.
    desk.device.chip.set_option(0, 3, 0xFF03_FF00);
    assert_eq!(desk.erase(FLASH).0, Status::ErrWrite as u8);
    desk.device.class_out(CLRSTATUS, 0, &[]).unwrap();
    assert_eq!(desk.erase(FLASH + 4 * PAGE as u32), DONE);
    desk.device
        .chip
        .set_option(0, 0, chip::FACTORY_OPTR & !0xFF | 0xBB);
    desk.device.class_out(ABORT, 0, &[]).unwrap();
    assert_eq!(desk.device.class_in(UPLOAD, 2, 8), Err(Refused::Stall));
    assert_eq!(
        desk.device.class_in(GETSTATUS, 0, 6).unwrap()[0],
        Status::ErrVendor as u8
    );
}

#[test]
fn option_bytes_reset_the_chip_and_their_complements_must_be_right() {
    let mut desk = Desk::new();
    desk.device.alternate = 1;
    desk.address(OPTIONS[0]);
    desk.device.class_out(ABORT, 0, &[]).unwrap();
    let mut bytes = desk.device.class_in(UPLOAD, 2, 48).unwrap();
    assert_eq!(bytes[..4], chip::FACTORY_OPTR.to_le_bytes());
    desk.device.class_out(ABORT, 0, &[]).unwrap();
    desk.address(OPTIONS[0]);
    bytes[3] &= !1;
    assert_eq!(desk.command(2, &bytes).unwrap().0, Status::ErrFile as u8);
    desk.device.class_out(CLRSTATUS, 0, &[]).unwrap();
    desk.address(OPTIONS[0]);
    bytes[7] |= 1;
    assert_eq!(desk.command(2, &bytes), Err(Refused::Gone));
    assert_eq!(desk.device.left(), Some(Left::Reset));
    assert_eq!(desk.device.chip.optr(), chip::FACTORY_OPTR & !(1 << 24));
}

#[test]
fn an_address_without_memory_is_refused_and_leaving_leaves() {
    let mut desk = Desk::new();
    let outside = [&[0x21][..], &0x2000_0000u32.to_le_bytes()].concat();
    assert_eq!(
        desk.command(0, &outside).unwrap(),
        (Status::ErrTarget as u8, 10)
    );
    desk.device.class_out(CLRSTATUS, 0, &[]).unwrap();
    desk.address(FLASH);
    desk.device.class_out(DNLOAD, 2, &[]).unwrap();
    assert_eq!(desk.device.class_in(GETSTATUS, 0, 6).unwrap()[4], 7);
    assert_eq!(desk.device.class_in(GETSTATUS, 0, 6), Err(Refused::Gone));
    assert_eq!(desk.device.left(), Some(Left::Program(FLASH)));
    desk.device.restart();
    assert_eq!(
        desk.device.class_in(UPLOAD, 0, 64),
        Ok(vec![0x00, 0x21, 0x41, 0x92])
    );
}

#[test]
fn a_host_that_asks_too_early_is_counted() {
    let mut desk = Desk::new();
    let erase = [&[0x41][..], &FLASH.to_le_bytes()].concat();
    desk.device.class_out(DNLOAD, 0, &erase).unwrap();
    for _ in 0..3 {
        let told = desk.device.class_in(GETSTATUS, 0, 6).unwrap();
        assert_eq!(told[4], State::DownloadBusy as u8);
        assert_eq!(told[1], 23);
    }
    assert_eq!(desk.device.early, 2);
}

#[test]
fn the_descriptors_are_as_long_as_they_say_and_name_the_layouts() {
    let mut device = Bootloader::new(Chip::default(), || Duration::ZERO);
    let mut get =
        |kind, index, length: u8| device.control([0x80, 6, index, kind, 0, 0, length, 0], &[]);
    let configuration = get(2, 0, 255).unwrap();
    assert_eq!(configuration.len(), configuration[2].into());
    assert_eq!(configuration.len(), 9 + 3 * 9 + 9);
    assert_eq!(get(1, 0, 8).unwrap().len(), 8);
    let text = |bytes: Vec<u8>| -> String {
        let units: Vec<_> = bytes[2..]
            .chunks(2)
            .map(|u| u16::from_le_bytes([u[0], u[1]]))
            .collect();
        String::from_utf16(&units).unwrap()
    };
    assert_eq!(
        text(get(3, 4, 255).unwrap()),
        "@Internal Flash   /0x08000000/256*02Kg"
    );
    assert_eq!(text(get(3, 3, 255).unwrap()).len(), 12);
    assert_eq!(get(6, 0, 10), Err(Refused::Stall));
    // An alternate setting that there is, and one that there is not.
    assert_eq!(device.control([1, 11, 2, 0, 0, 0, 0, 0], &[]), Ok(vec![]));
    assert_eq!(
        device.control([0x81, 10, 0, 0, 0, 0, 1, 0], &[]),
        Ok(vec![2])
    );
    assert_eq!(
        device.control([1, 11, 3, 0, 0, 0, 0, 0], &[]),
        Err(Refused::Stall)
    );
}

#[test]
fn faults_leave_the_flash_half_done() {
    let mut desk = Desk::new();
    desk.address(FLASH);
    desk.device.expect(Fault::PowerLost {
        after_operations: 1,
    });
    assert_eq!(desk.command(2, &[0; 64]), Ok(DONE));
    assert_eq!(desk.command(3, &[0; 64]), Err(Refused::Gone));
    assert_eq!(desk.device.chip.flash[96..128], [0xFF; 32]);
    desk.device.restart();
    desk.device.expect(Fault::Unplugged { after_requests: 2 });
    assert!(desk.device.class_in(GETSTATUS, 0, 6).is_ok());
    assert!(desk.device.class_in(GETSTATUS, 0, 6).is_ok());
    assert_eq!(desk.device.class_in(GETSTATUS, 0, 6), Err(Refused::Gone));
}
