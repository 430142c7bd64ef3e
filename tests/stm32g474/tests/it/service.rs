//! Services of the board besides heating (docs/protocol.md, 2.2): restart, identity, tests, link, log.

use std::time::Duration;

use ihd_link::{Client, DeviceEvent, LinkError};
use ihd_shared::board::{MAINS_FULL_SCALE_MV, MAINS_VOLTAGE_V};
use ihd_shared::image::{self, Header};
use ihd_shared::sampling::{AMPERE_PER_CODE, CODE_HALF_RANGE, VOLT_PER_CODE};
use ihd_shared::wire::messages::{Outcome, Program, State};
use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};
use ihd_sim::behavioural::PotKind;
use ihd_sim::injection::InjectionKind;
use ihd_sim::scenario::surroundings::ChangeableHob;
use ihd_stm32g474::chip::Reset;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::processor::{BOOTLOADER, BOOTLOADER_STACK};
use ihd_stm32g474::registers as reg;

use crate::board::{
    Bench, assert_no_violations, connect, inject, resets, take_mains_off, with_pot,
};

fn outcome<T: std::fmt::Debug>(result: Result<T, LinkError>) -> Outcome {
    match result {
        Err(LinkError::Refused { outcome, .. }) => outcome,
        other => panic!("{other:?}"),
    }
}

fn bridge(bench: &Bench) -> Bridge {
    bench.with(|machine| machine.chip().pins.bridge())
}

fn is_in_bootloader(bench: &Bench) -> bool {
    let pc = bench.with(|machine| machine.pc());
    (BOOTLOADER as u32..BOOTLOADER as u32 + 0x7000).contains(&pc)
}

#[test]
fn it_says_what_it_is() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let facts = connect(&bench).board().unwrap();
    assert_eq!(facts.id_code & 0xFFF, image::DEVICE_ID);
    assert_eq!(facts.flash_kib, 512);
    assert_eq!(facts.starts, 1);
    // BORRSTF and IWDGRSTF: power-on, and the test of the watchdog.
    assert_eq!(facts.reset_flags & 0x2800_0000, 0x2800_0000);
    // DBANK 1, SRAM_PE 0.
    assert_eq!(facts.option_bytes & 0x0140_0000, 0x0040_0000);
    assert_eq!(
        facts.chip,
        b"\x12\x34\x56\x78\x9a\xbc\xde\xf0\x11\x22\x33\x44"
    );
    assert_eq!(facts.image_crc, facts.sealed_crc);
    // A probe reads the same from the flash.
    let flash = |address, bytes| bench.with(move |machine| machine.memory(address, bytes));
    let header = Header::parse(&flash(image::HEADER_ADDRESS, image::HEADER_BYTES)).unwrap();
    assert_eq!(
        (header.protocol_major, header.protocol_minor),
        (PROTOCOL_MAJOR, PROTOCOL_MINOR)
    );
    assert_eq!(header.crc_address - image::FLASH_ADDRESS, facts.image_bytes);
    assert_eq!(flash(header.crc_address, 4), facts.sealed_crc.to_le_bytes());
    let id = image::build_id(&flash(image::NOTE_ADDRESS, image::NOTE_BYTES)).unwrap();
    assert_eq!(facts.build_id, id);
    assert_no_violations(&bench);
}

/// State as after a reset: no part of the chip is switched on, and the pins are released.
#[test]
fn it_restarts_into_the_bootloader_and_comes_back() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    // The bootloader drives the pins of both switches.
    assert_eq!(
        outcome(client.restart(Program::Bootloader)),
        Outcome::NotIdle
    );
    // A broken bus divider reads no voltage.
    let broken = bench.with(|machine| inject(machine, InjectionKind::BusScale, 0.0));
    bench.run_s(0.05);
    assert_eq!(
        outcome(client.restart(Program::Bootloader)),
        Outcome::NotIdle
    );
    bench.with(move |machine| machine.chip().pins.inject(|all| all.end(broken)));
    take_mains_off(&bench);
    client.restart(Program::Bootloader).unwrap();
    assert!(!is_in_bootloader(&bench), "the answer must leave first");
    bench.run_s(0.2);
    assert!(is_in_bootloader(&bench));
    assert_eq!(resets(&bench), [Reset::Software]);
    bench.with(|machine| {
        assert_eq!(machine.sp(), BOOTLOADER_STACK);
        let file = &machine.chip().file;
        assert_eq!(file.word(reg::gpioa::moder::ADDRESS), 0xABFF_FFFF);
        // HSI16, and the clocks that are on after a reset (RM0440, 7.4: only RTCAPBEN of these).
        assert_eq!(file.word(reg::rcc::rcc_cfgr::ADDRESS) & 0xF, 5);
        for (enabled, after_reset) in [
            (reg::rcc::rcc_ahb2enr::ADDRESS, 0),
            (reg::rcc::rcc_apb1enr1::ADDRESS, 0x400),
            (reg::rcc::rcc_apb2enr::ADDRESS, 0),
        ] {
            assert_eq!(file.word(enabled), after_reset, "{enabled:#x}");
        }
        // System memory at address 0.
        assert_eq!(file.word(reg::syscfg::memrmp::ADDRESS) & 7, 1);
    });
    assert_eq!(bridge(&bench), Bridge::Open);
    // Only once: the next reset starts the firmware.
    bench.run_s(0.1);
    bench.with(|machine| machine.chip().reset = Some(Reset::Software));
    bench.run_s(0.1);
    let mut client = connect(&bench);
    assert_eq!(client.board().unwrap().starts, 2);
    assert_no_violations(&bench);
}

/// ST's bootloader starts a program by a jump, with its clock on.
#[test]
fn who_jumps_to_it_from_another_program_gets_it_from_its_beginning() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(|machine| {
        // With the PLL on, as the program has left it.
        let entry = machine.memory(image::FLASH_ADDRESS + 4, 4);
        machine.set_pc(u32::from_le_bytes(entry.try_into().unwrap()) & !1);
    });
    bench.run_s(0.1);
    assert_eq!(resets(&bench), [Reset::Software]);
    assert_eq!(connect(&bench).status().unwrap().state, State::Idle);
}

#[test]
fn a_restart_is_told_as_one_that_software_asked_for() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let before = client.hello().boot_id;
    client.restart(Program::Firmware).unwrap();
    bench.run_s(0.3);
    assert_eq!(resets(&bench), [Reset::Software]);
    let mut client = connect(&bench);
    assert_eq!(client.hello().reset_reason, 5);
    assert_ne!(client.hello().boot_id, before);
    assert_eq!(client.board().unwrap().starts, 2);
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_no_violations(&bench);
}

#[test]
fn no_two_starts_have_the_same_boot_id() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut ids = vec![connect(&bench).hello().boot_id];
    let mut power_cycle = |without_noise| {
        bench.with(move |machine| {
            machine.chip().random.broken = without_noise;
            machine.power_cycle().unwrap();
        });
        bench.run_s(0.1);
        ids.push(connect(&bench).hello().boot_id);
    };
    power_cycle(false);
    power_cycle(false);
    // Without noise it starts all the same.
    power_cycle(true);
    assert_no_violations(&bench);
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), 4, "{ids:x?}");
}

#[test]
fn while_it_heats_nothing_of_it_is_done() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    for program in [Program::Bootloader, Program::Firmware] {
        assert_eq!(outcome(client.restart(program)), Outcome::NotIdle);
    }
    assert_eq!(outcome(client.comparators()), Outcome::NotIdle);
    assert_eq!(outcome(client.channels()), Outcome::NotIdle);
    assert_eq!(outcome(client.clocks()), Outcome::NotIdle);
    // Requests that only read are answered.
    client.board().unwrap();
    bench.run_s(0.2);
    assert!(matches!(bridge(&bench), Bridge::Switching { .. }));
    let status = client.status().unwrap();
    assert_eq!((status.state, resets(&bench)), (State::Heating, vec![]));
    assert_eq!(status.fault, ihd_shared::fault::Fault::NONE);
    assert_no_violations(&bench);
}

#[test]
fn the_channels_show_offsets_that_are_on_the_pins() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let none = client.channels().unwrap();
    bench.with(|machine| {
        inject(machine, InjectionKind::VoltageOffset, -9.0 * VOLT_PER_CODE);
        inject(
            machine,
            InjectionKind::CurrentOffset,
            14.0 * AMPERE_PER_CODE,
        );
        inject(machine, InjectionKind::Supply, 3.2 / 3.3);
    });
    bench.run_s(0.02);
    let some = client.channels().unwrap();
    println!("{none:?}\n{some:?}");
    let near = |x: i32, codes: i32| (x - codes * 256).abs() < 64;
    assert!(near(none.v_mean, 0) && near(none.i_mean, 0), "{none:?}");
    assert!(near(some.v_mean, -9) && near(some.i_mean, 14), "{some:?}");
    assert!(some.samples > 10_000 && some.slow_samples > 300, "{some:?}");
    // On the reference board 230 V of a full scale of 400 V, which is 2 048 codes at 3.3 V.
    let share = f64::from(MAINS_VOLTAGE_V) * 1e3 / f64::from(MAINS_FULL_SCALE_MV);
    let mains = f64::from(some.mains_rms) / 256.0 / (share * f64::from(CODE_HALF_RANGE));
    assert!((mains * 3.2 / 3.3 - 1.0).abs() < 0.02, "{some:?}");
    for (found, vdda_mv) in [(&none, 3_300), (&some, 3_200)] {
        assert!(found.vdda_mv.abs_diff(vdda_mv) < 3, "{found:?}");
    }
    assert_no_violations(&bench);
}

#[test]
fn comparators_that_work_and_one_that_does_not_are_told_apart() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let all = |found: &ihd_shared::wire::messages::Comparators| {
        [
            found.positive_tripped,
            found.positive_quiet,
            found.negative_tripped,
            found.negative_quiet,
        ]
    };
    assert_eq!(all(&client.comparators().unwrap()), [true; 4]);
    bench.with(|machine| machine.chip().pins.dead_comparators = [true, false]);
    assert_eq!(
        all(&client.comparators().unwrap()),
        [false, true, true, true]
    );
    bench.with(|machine| machine.chip().pins.dead_comparators = [false, true]);
    assert_eq!(
        all(&client.comparators().unwrap()),
        [true, true, false, true]
    );
    bench.with(|machine| machine.chip().pins.dead_comparators = [false; 2]);
    // Heating works as before.
    client.set_power(1_200).unwrap();
    bench.run_s(0.3);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_no_violations(&bench);
}

#[test]
fn the_clocks_are_counted_against_each_other() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    let found = client.clocks().unwrap();
    println!("{found:?}");
    assert_eq!(found.main_hz, 170_000_000);
    // 0.5 s of 32 kHz.
    assert!((15_000..16_100).contains(&found.lsi_periods), "{found:?}");
    let lsi_hz = f64::from(found.lsi_periods) * 170e6 / f64::from(found.lsi_main_cycles);
    assert!((lsi_hz / 32_000.0 - 1.0).abs() < 0.002, "{lsi_hz}");
    // No cable.
    assert_eq!((found.usb_frames, found.hsi48_off), (0, 0));
    // The self-tests continued meanwhile.
    bench.run_s(0.7);
    assert_eq!(client.status().unwrap().fault.number(), 0);
    assert_no_violations(&bench);
}

#[test]
fn the_serial_link_carries_what_it_should_in_both_directions() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_timeout(Duration::from_secs(10));
    let test = client.test_link(15, 900).unwrap();
    println!("{test:?}");
    assert_eq!((test.from_device.frames, test.from_device.lost), (15, 0));
    assert_eq!((test.from_device.bytes, test.from_device.bad), (13_500, 0));
    // 921 600 baud are 92 160 bytes a second; 900 bytes are 920 on the wire.
    let rate = 15.0 * 920.0 / test.from_device_took.as_secs_f64();
    assert!((80e3..95e3).contains(&rate), "{rate}");
    assert_eq!(test.to_device.bad, 0);
    assert_no_violations(&bench);
}

/// Content of RTT's buffer, which no probe has read.
fn rtt(bench: &Bench) -> Vec<u8> {
    bench.with(|machine| {
        let block = machine.image().symbol("_SEGGER_RTT").unwrap();
        let word = |at: u32| u32::from_le_bytes(machine.memory(block + at, 4).try_into().unwrap());
        assert_eq!(machine.memory(block, 10), b"SEGGER RTT");
        assert_eq!(machine.memory(word(24), 6), b"defmt\0");
        let (buffer, size, write, read) = (word(28), word(32), word(36), word(40));
        assert!(write < size && read == 0);
        machine.memory(buffer, write as usize)
    })
}

/// Log bytes that arrive within a time, and the frames dropped before the last of them.
fn logged(client: &mut Client, while_s: f64) -> (Vec<u8>, u32) {
    let until = client.clock() + Duration::from_secs_f64(while_s);
    let (mut all, mut dropped) = (Vec::new(), 0);
    while client.clock() < until {
        if let Some(DeviceEvent::Log {
            seq,
            dropped: so_far,
            data,
        }) = client.next_event(Duration::from_millis(20)).unwrap()
        {
            assert_eq!(seq as usize, all.len(), "nothing is missing");
            assert_eq!(data.last(), Some(&0), "whole frames");
            all.extend(data);
            dropped = so_far;
        }
    }
    (all, dropped)
}

#[test]
fn the_log_over_the_link_is_the_log_over_rtt() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    // Late request, as in a recording of boots: the lines of the start are there.
    client.stream_log(true).unwrap();
    let (link, dropped) = logged(&mut client, 0.3);
    let probe = rtt(&bench);
    assert!(
        probe.iter().filter(|&&byte| byte == 0).count() >= 6,
        "{probe:?}"
    );
    assert_eq!((link, dropped), (probe, 0));
    // Each host must request the log itself.
    let mut other = connect(&bench);
    assert_eq!(logged(&mut other, 0.1), (vec![], 0));
    assert_no_violations(&bench);
}
