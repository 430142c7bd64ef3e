//! This build's firmware as a device without hardware: no time passes, and every reply is available at once.

use std::time::Duration;

use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::SamplingPath;
use ihd_link::{LinkError, Transport};
use ihd_shared::lookup::prior::start_load;
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};

/// Firmware and the device's end of a link.
pub struct ReferenceDevice {
    housekeeping: Housekeeping,
    sampling_path: Box<SamplingPath>,
    to_host: Vec<u8>,
}

impl Default for ReferenceDevice {
    fn default() -> Self {
        let build = concat!("ihd ", env!("CARGO_PKG_VERSION"));
        let (r, l) = start_load();
        Self {
            housekeeping: Housekeeping::new(ours(ROLE_DEVICE, CAP_SIMULATED, 0, build, "host")),
            sampling_path: Box::new(SamplingPath::new(r, l)),
            to_host: Vec::new(),
        }
    }
}

impl ReferenceDevice {
    fn transmit(&mut self) {
        let mut frame = [0; MAX_ENCODED];
        loop {
            self.housekeeping.poll(&mut *self.sampling_path);
            let length = self
                .housekeeping
                .transmit(&mut *self.sampling_path, &mut frame);
            if length == 0 {
                return;
            }
            self.to_host.extend_from_slice(&frame[..length]);
        }
    }
}

impl Transport for ReferenceDevice {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.housekeeping.receive(&mut *self.sampling_path, bytes);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], _: Duration) -> Result<usize, LinkError> {
        self.transmit();
        let length = buf.len().min(self.to_host.len());
        for (slot, byte) in buf.iter_mut().zip(self.to_host.drain(..length)) {
            *slot = byte;
        }
        Ok(length)
    }

    fn describe(&self) -> String {
        "this build of the firmware".to_owned()
    }
}
