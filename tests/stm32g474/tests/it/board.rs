//! Board for a test: the image that `cargo xtask test --only board` built, a pot, the serial cable.

use std::path::PathBuf;
use std::sync::LazyLock;
use std::time::Duration;

use ihd_link::{Client, Transport};
use ihd_shared::board::MAINS_FREQUENCY_HZ;
use ihd_sim::behavioural::PotKind;
use ihd_sim::injection::{Injection, InjectionKind};
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_sim::recording::settings::LoadKind;
use ihd_sim::scenario::surroundings::ChangeableHob;
pub use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::chip::Reset;
use ihd_stm32g474::cpu::nvic::FIRST_INTERRUPT;
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::pins::front_end;

/// Exception number of DMA1's first channel: the sampling path.
pub const SAMPLING: usize = FIRST_INTERRUPT + 11;

/// Image under test.
pub static IMAGE: LazyLock<PathBuf> = LazyLock::new(|| {
    let path = std::env::var_os("IHD_STM32G474_IMAGE")
        .expect("`cargo xtask test --only board` names the image");
    PathBuf::from(path)
});

/// Powered-up board with a pot.
pub fn with_pot(pot: PotKind) -> Bench {
    let plant = move || {
        Plant::with_load(
            SimulatedMains::of_board(),
            pot,
            LoadKind::Behavioural,
            front_end(1),
        )
    };
    Bench::power_up(&IMAGE, plant).expect("the image is there")
}

/// Client of the host at the serial cable.
pub fn connect(bench: &Bench) -> Client {
    over(bench.serial())
}

/// Client of the host over any cable.
pub fn over(transport: impl Transport + 'static) -> Client {
    let mut client = Client::connect(Box::new(transport)).expect("the board answers");
    client.set_timeout(Duration::from_secs(2));
    client
}

/// Takes the mains off until the DC link is discharged: 4.7 µF into bleeder and divider, 0.40 s from 325 V to 120 V.
pub fn take_mains_off(bench: &Bench) {
    set_mains(bench, 0.0);
    bench.run_s(1.5);
}

/// Sets the voltage of the mains in volt rms.
pub fn set_mains(bench: &Bench, v_rms_v: f64) {
    let frequency_hz = f64::from(MAINS_FREQUENCY_HZ);
    bench.with(move |machine| {
        let plant = &mut machine.chip().pins.plant;
        plant.change_mains(v_rms_v, frequency_hz);
    });
}

/// Injects a fault with its value, of the kind's usual channel; returns the number that ends it.
pub fn inject(machine: &mut Machine, kind: InjectionKind, value: f64) -> u32 {
    let channel = kind.default_channel();
    let mut number = 0;
    machine.chip().pins.inject(|all| {
        number = all.start(Injection {
            kind,
            value,
            channel,
        });
    });
    number
}

/// Fails if the program violated the reference manual.
pub fn assert_no_violations(bench: &Bench) {
    let violations = bench.with(|machine| machine.violations());
    let list: Vec<_> = violations.iter().map(ToString::to_string).collect();
    assert!(list.is_empty(), "{}", list.join("\n"));
}

/// Causes of all resets of the board since power-on.
pub fn resets(bench: &Bench) -> Vec<Reset> {
    bench.with(|machine| machine.resets.iter().map(|reset| reset.1).collect())
}
