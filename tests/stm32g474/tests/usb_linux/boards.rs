//! What is plugged into the guest: stand-ins for the board, each on a thread of its own, with the simulated hob
//! behind the bulk endpoints.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ihd_sim::hob::{HobConfig, SimHob};
use ihd_stm32g474::usb::stand_in::{Function, StandIn};
use ihd_stm32g474::usb::{Cable, HostController};

/// One packet for the host: never a full one, as in the firmware.
const PACKET: usize = 63;
/// How often the controller is polled.
const STEP_US: f64 = 10.0;

struct Hob {
    hob: SimHob,
    milliseconds: u32,
}

impl Function for Hob {
    fn take(&mut self, bytes: &[u8]) -> bool {
        self.hob.send(bytes);
        true
    }

    fn give(&mut self) -> Option<Vec<u8>> {
        let mut packet = [0; PACKET];
        let length = self.hob.receive(&mut packet);
        (length > 0).then(|| packet[..length].to_vec())
    }

    fn millisecond(&mut self) {
        self.milliseconds += 1;
        while self.hob.t_s() * 1e3 < f64::from(self.milliseconds) {
            self.hob.step();
        }
    }
}

/// A machine: its cable, and the thread that ends with this value.
pub struct Board {
    /// To be given to a USB/IP server.
    pub cable: Cable,
    stop: Arc<AtomicBool>,
}

impl Board {
    /// A stand-in, in real time.
    pub fn stand_in(serial: &'static str) -> Self {
        let (cable, controller) = Cable::new();
        let stop = Arc::<AtomicBool>::default();
        let stopped = Arc::clone(&stop);
        thread::spawn(move || run(serial, controller, &stopped));
        Self { cable, stop }
    }
}

fn run(serial: &str, mut controller: HostController, stop: &AtomicBool) {
    let hob = SimHob::new(&HobConfig {
        link_bytes_per_s: 1e6,
        ..HobConfig::default()
    });
    let mut device = StandIn::new(
        serial,
        Hob {
            hob,
            milliseconds: 0,
        },
    );
    let (began, mut now_us) = (Instant::now(), 0.0);
    while !stop.load(Ordering::Relaxed) {
        if now_us > began.elapsed().as_secs_f64() * 1e6 {
            thread::sleep(Duration::from_micros(200));
            continue;
        }
        now_us += STEP_US;
        controller.poll(&mut device, now_us);
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}
