//! Boards that are plugged into the guest: the image on emulated chips, each on a thread of its own.

use std::path::Path;

use ihd_shared::sampling::ANTI_ALIAS_HZ;
use ihd_sim::adc::{ConverterNoise, SimulatedAdc};
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::usb::Cable;

/// Address of the chip's unique number from the factory, from which the board derives its serial number.
const UNIQUE: u32 = 0x1FFF_7590;

/// Emulated board with its cable; it ends with this value.
pub struct Board {
    /// Cable for a USB/IP server.
    pub cable: Cable,
    /// Bench with the emulated chip.
    pub bench: Bench,
}

impl Board {
    /// Runs the image as fast as possible on a chip whose unique number begins with `unique`.
    pub fn emulated(image: &Path, unique: u8) -> anyhow::Result<Self> {
        let filtered = |seed| {
            SimulatedAdc::of_board(ConverterNoise::default(), seed, f64::from(ANTI_ALIAS_HZ))
        };
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
