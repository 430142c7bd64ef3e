//! What is plugged into the guest: the image on emulated chips, each on a thread of its own.

use std::path::Path;

use ihd_sim::adc::{ConverterNoise, SimulatedAdc};
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::usb::Cable;

/// Where the factory writes the chip's unique number, of which the board makes its serial number.
const UNIQUE: u32 = 0x1FFF_7590;

/// A machine: its cable, and what ends with this value.
pub struct Board {
    /// To be given to a USB/IP server.
    pub cable: Cable,
    /// The emulated chip.
    pub bench: Bench,
}

impl Board {
    /// The image, on a chip whose unique number begins with `unique`; it runs from now on, as fast as it can.
    pub fn emulated(image: &Path, unique: u8) -> anyhow::Result<Self> {
        let filtered = |seed| SimulatedAdc::new(ConverterNoise::default(), seed).with_filter(500e3);
        let plant = move || {
            Plant::new(
                SimulatedMains::of_board(),
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
        Ok(Self { cable, bench })
    }
}
