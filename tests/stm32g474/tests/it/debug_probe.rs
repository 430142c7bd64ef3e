//! `ihd flash` through a debug probe onto the emulated chip: ST's flash algorithm runs there, and the flashed image boots.

use std::time::Duration;

use ihd_debug_port::Contact;
use ihd_debug_port::probe::Desk;
use ihd_flash::install::{InstallError, InstallPlan, InstallReport, install};
use ihd_flash::probe::Probes;
use ihd_flash::{Erase, Image, ProgramError, WriteProgress};
use ihd_shared::fault::Fault;
use ihd_shared::image::FLASH_ADDRESS;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;
use ihd_sim::mains::SimulatedMains;
use ihd_sim::plant::Plant;
use ihd_sim::recording::settings::LoadKind;
use ihd_stm32g474::bench::Bench;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::debugged::DebuggedBoard;
use ihd_stm32g474::pins::front_end;
use ihd_stm32g474::time::{seconds, us};

use crate::board::{IMAGE, assert_no_violations, connect, with_pot};

fn image() -> Image {
    Image::read(&IMAGE).expect("the image under test")
}

/// Board as delivered, with an empty flash.
fn blank() -> Bench {
    let erased = ihd_stm32g474::image::Image::read(&IMAGE).expect("the image under test");
    let plant = || {
        let pot = PotKind::Ferromagnetic;
        Plant::with_load(
            SimulatedMains::of_board(),
            pot,
            LoadKind::Behavioural,
            front_end(1),
        )
    };
    Bench::power_up_with(erased.erased(), plant).expect("the emulator starts")
}

fn flash(
    desk: &Desk<DebuggedBoard>,
    image: &Image,
    on: &mut dyn FnMut(WriteProgress),
) -> Result<InstallReport, InstallError> {
    let mut programmer = Probes::with(desk.lister()).attach(None)?;
    let plan = InstallPlan {
        image,
        erase: Erase::Image,
        set_options: false,
        hello_within: Duration::ZERO,
        hello_required: false,
    };
    install(&mut programmer, None, plan, &mut |step| {
        if let ihd_flash::install::InstallStep::Flash(progress) = step {
            on(progress);
        }
    })
}

fn in_flash(bench: &Bench, bytes: usize) -> Vec<u8> {
    bench.with(move |machine| machine.memory(FLASH_ADDRESS, bytes))
}

#[test]
fn a_blank_chip_is_flashed_by_sts_algorithm_and_boots() {
    let (bench, image) = (blank(), image());
    let desk = Desk::new(DebuggedBoard::new(bench.clone()));
    let mut last = None;
    let report = flash(&desk, &image, &mut |progress| last = Some(progress)).unwrap();
    // As delivered but for parity, only the brown-out level is to be raised.
    let names: Vec<_> = report.deviations.iter().map(|one| one.name).collect();
    assert_eq!(names, ["BOR_LEV"]);
    let flat = image.flat();
    assert!(
        matches!(last, Some(WriteProgress::Verifying { done, total }) if done == total),
        "{last:?}"
    );
    assert!(
        in_flash(&bench, flat.len()) == flat,
        "what was flashed is not the image"
    );
    assert_no_violations(&bench);
    let mut client = connect(&bench);
    assert!(client.hello().build.as_str().starts_with(&image.build));
    let board = client.board().unwrap();
    assert_eq!(board.build_id, image.build_id.0);
    assert_eq!(board.image_crc, image.crc);
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert_no_violations(&bench);
}

#[test]
fn while_it_heats_nothing_is_written_and_the_bridge_goes_on() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.2);
    bench.with(|machine| machine.chip().hrtim.off_at = None);
    let before = client.status().unwrap();
    assert_eq!(before.state, State::Heating);
    let desk = Desk::new(DebuggedBoard::new(bench.clone()));
    let why = flash(&desk, &image(), &mut |_| ()).unwrap_err();
    assert!(matches!(why, InstallError::Heats { .. }), "{why}");
    let after = client.status().unwrap();
    assert_eq!((after.state, after.fault), (State::Heating, before.fault));
    let (off_at, resets) = bench.with(|m| (m.chip().hrtim.off_at, m.resets.len()));
    assert_eq!((off_at, resets), (None, 0));
    assert_no_violations(&bench);
}

/// RM0440, 27.3.22: with DBG_HRTIM_STOP = 1 a halt of the core puts the outputs into FAULT state, for good.
#[test]
fn a_halt_while_it_heats_opens_the_bridge_at_once_and_is_a_fault() {
    let bench = with_pot(PotKind::Ferromagnetic);
    connect(&bench).set_power(1_200).unwrap();
    bench.run_s(0.2);
    let (off_us, bridge) = bench.with(|machine| {
        machine.chip().hrtim.off_at = None;
        let began = machine.now();
        machine.halt().unwrap();
        machine.run_for(us(2_000)).unwrap();
        let off = machine.chip().hrtim.off_at.expect("the outputs went off");
        machine.go_on().unwrap();
        machine.run_for(us(2_000)).unwrap();
        (seconds(off - began) * 1e6, machine.chip().pins.bridge())
    });
    assert!(off_us < 1.0, "{off_us} µs");
    assert_eq!(bridge, Bridge::Open);
    let status = connect(&bench).status().unwrap();
    assert_eq!(status.fault, Fault::SAMPLES_LOST);
    assert_no_violations(&bench);
}

/// A halt that is too short for the sampling watchdog leaves the outputs in FAULT state without a flag.
#[test]
fn a_short_halt_while_it_heats_is_a_fault_that_restarts() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.2);
    bench.with(|machine| {
        machine.halt().unwrap();
        machine.run_for(us(100)).unwrap();
        machine.go_on().unwrap();
        machine.run_for(us(500)).unwrap();
    });
    assert_eq!(client.status().unwrap().fault, Fault::SAMPLES_LOST);
    bench.run_s(0.5);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_no_violations(&bench);
}

#[test]
fn a_probe_that_is_pulled_in_the_middle_leaves_what_a_second_run_mends() {
    let (bench, image) = (blank(), image());
    let desk = Desk::new(DebuggedBoard::new(bench.clone()));
    let pulled = desk.clone();
    let middle = image.bytes / 2;
    let why = flash(&desk, &image, &mut |progress| {
        if matches!(progress, WriteProgress::Programming { done, .. } if done > middle) {
            // The progress is reported between two accesses.
            pulled.with(|board| board.set_contact(Contact::NoProbe));
        }
    });
    let why = why.expect_err("the probe is gone");
    assert!(
        matches!(why, InstallError::Program(ProgramError::Lost { .. })),
        "{why}"
    );
    desk.with(|board| board.set_contact(Contact::Good));
    flash(&desk, &image, &mut |_| ()).unwrap();
    let flat = image.flat();
    assert!(
        in_flash(&bench, flat.len()) == flat,
        "what was flashed is not the image"
    );
    let mut client = connect(&bench);
    assert_eq!(client.status().unwrap().state, State::Idle);
}
