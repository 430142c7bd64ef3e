//! Tests and facts of the board for a host (`ihd_firmware::link::service`).

use embassy_stm32::uid;
use ihd_firmware::link::channel_test::SlowCodes;
use ihd_firmware::link::identity::DeviceIdentity;
use ihd_firmware::link::service::BoardServices;
use ihd_firmware::retained::reset::CrashRecord;
use ihd_firmware::sense::supply::Reference;
use ihd_shared::wire::messages::{Clocks, Comparators, Program};

use super::registers::{comparators, supply};
use super::self_test::SelfTest;
use super::temperatures::TemperatureAdc;
use super::{adc, image};
use crate::board::crash;

/// The board's parts for its services.
pub struct ChipServices<'a> {
    /// Has the clocks.
    pub self_test: &'a mut SelfTest,
    /// Has the reference.
    pub temperatures: &'a TemperatureAdc,
}

impl BoardServices for ChipServices<'_> {
    fn has_program(&self, _: Program) -> bool {
        true
    }

    fn restart(&mut self, into: Program) {
        crash::restart(into)
    }

    fn slow_codes(&mut self) -> Option<SlowCodes> {
        Some(adc::slow_codes())
    }

    fn reference(&mut self) -> Option<Reference> {
        Some(self.temperatures.reference())
    }

    fn comparators(&mut self) -> Option<Comparators> {
        Some(comparators::trip())
    }

    fn begin_clocks(&mut self) -> bool {
        self.self_test.begin_clocks();
        true
    }

    fn clocks(&mut self) -> Option<Clocks> {
        self.self_test.clocks()
    }
}

/// Identity of chip and program. `reset_flags` is RCC_CSR as it was found, `last` what the last run left.
pub fn identity(
    reset_flags: u32,
    last: Option<CrashRecord>,
    self_test: &SelfTest,
) -> DeviceIdentity {
    let sealed = self_test.sealed();
    let before = last.map_or(0, |record| record.starts.saturating_add(1));
    DeviceIdentity {
        id_code: supply::id_code(),
        flash_kib: supply::flash_kib(),
        option_bytes: supply::option_bytes(),
        reset_flags,
        starts: u8::try_from(before.saturating_add(1)).unwrap_or(u8::MAX),
        image_bytes: sealed.bytes,
        image_crc: sealed.crc,
        sealed_crc: sealed.sealed_crc,
        build_id: image::own_build_id(),
        chip: Some(uid::uid()),
    }
}
