//! What is plugged into the guest: the image on the emulated chip, or a stand-in with the simulated hob behind its
//! bulk endpoints, in real time. Each runs on a thread of its own.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use ihd_sim::adc::{Adc, Noise};
use ihd_sim::behavioural::PotKind;
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::mains::Mains;
use ihd_sim::plant::Plant;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::usb::stand_in::{Function, StandIn};
use ihd_stm32g474::usb::{Cable, HostController};

/// One packet for the host: never a full one, as in the firmware.
const PACKET: usize = 63;
/// How often a stand-in's bus is looked after.
const STEP_US: f64 = 10.0;
/// Where the factory writes the chip's unique number, of which the board makes its serial number.
const UNIQUE: u32 = 0x1FFF_7590;

/// A machine: its cable, and what ends with this value.
pub struct Board {
    /// To be given to a USB/IP server.
    pub cable: Cable,
    /// The emulated chip, where it is one.
    pub bench: Option<Bench>,
    stop: Arc<AtomicBool>,
}

impl Board {
    /// A stand-in with a serial number.
    pub fn stand_in(serial: &'static str) -> Self {
        let (cable, controller) = Cable::new();
        let stop = Arc::<AtomicBool>::default();
        let stopped = Arc::clone(&stop);
        thread::spawn(move || run(serial, controller, &stopped));
        Self {
            cable,
            bench: None,
            stop,
        }
    }

    /// The image, on a chip whose unique number begins with `unique`; it runs from now on, as fast as it can.
    pub fn emulated(image: &Path, unique: u8) -> anyhow::Result<Self> {
        let filtered = |seed| Adc::new(Noise::default(), seed).with_filter(500e3);
        let plant = move || {
            Plant::new(
                Mains::new(50.0),
                PotKind::Ferromagnetic,
                filtered(unique.into()),
            )
        };
        let bench = Bench::power_up(image, plant)?;
        let cable = bench.with(move |machine| {
            machine.set_memory(UNIQUE, &[unique]);
            machine.cable.clone()
        });
        bench.run_freely(true);
        Ok(Self {
            cable,
            bench: Some(bench),
            stop: Arc::default(),
        })
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

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
