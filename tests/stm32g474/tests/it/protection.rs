//! Each cause that opens the bridge, with its time to outputs off.

use ihd_shared::board::TRIP_CURRENT_MA;
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::State;
use ihd_sim::behavioural::PotKind;
use ihd_sim::front_end::NOMINAL_SUPPLY_V;
use ihd_sim::injection::DETECTOR_V;
use ihd_stm32g474::chip::hrtim::Bridge;
use ihd_stm32g474::chip::{Chip, Reset};
use ihd_stm32g474::cpu::CycleModel;
use ihd_stm32g474::cpu::nvic::NMI;
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::registers::{Field, dma1, flash, hrtim_common, syscfg};
use ihd_stm32g474::time::{seconds, us};

use crate::board::{Bench, SAMPLING, assert_no_violations, connect, resets, set_mains, with_pot};

/// Supply in volt that the detector takes for low.
const SAGGED_V: f64 = DETECTOR_V - 0.05;

/// Board that heats.
fn heating() -> Bench {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.12);
    let bridge = bench.with(|machine| machine.chip().pins.bridge());
    assert!(matches!(bridge, Bridge::Switching { .. }), "{bridge:?}");
    bench
}

/// Applies `what` to the machine; returns the microseconds until the outputs are off, at most `within_ms` later.
fn time_to_off(
    bench: &Bench,
    within_ms: u64,
    what: impl FnOnce(&mut Machine) + Send + 'static,
) -> f64 {
    bench.with(move |machine| {
        machine.chip().hrtim.off_at = None;
        what(machine);
        // Measured from here, as the thread may have been busy before.
        let began = machine.now();
        machine.run_for(us(1_000 * within_ms)).unwrap();
        let off = machine.chip().hrtim.off_at.expect("the outputs went off");
        seconds(off.saturating_sub(began)) * 1e6
    })
}

/// Reset reason and fault before the reset, as the restarted board reports them.
fn after_reset(bench: &Bench) -> (u8, u16) {
    let client = connect(bench);
    (
        client.hello().reset_reason,
        client.hello().fault_before_reset,
    )
}

/// Runs until the thread waits for an event and no handler runs.
fn reach_thread(machine: &mut Machine) {
    while machine.chip().nvic.is_handler() || !machine.sleeping() {
        machine.run_for(500).unwrap();
    }
}

#[test]
fn a_surge_of_current_trips_the_comparator_without_software() {
    // Above the trip level at any phase of the heating current.
    let most_a = 1.6e-3 * f64::from(TRIP_CURRENT_MA);
    for surge_a in [most_a, -most_a] {
        let bench = heating();
        let off_us = time_to_off(&bench, 1, move |machine| {
            machine.chip().pins.surge_a = surge_a
        });
        println!("comparator, {surge_a} A: off after {off_us:.2} µs");
        // A sampling period of 0.82 µs at 60 kHz until the surge acts, and the filter's 0.33 µs.
        assert!(off_us < 2.0, "{off_us} µs");
        bench.with(|machine| machine.chip().pins.surge_a = 0.0);
        let status = connect(&bench).status().unwrap();
        assert_eq!(status.fault, Fault::HARDWARE_OVER_CURRENT);
    }
}

#[test]
fn a_surge_below_the_level_does_not_trip() {
    let bench = heating();
    bench.with(|machine| {
        machine.chip().hrtim.off_at = None;
        // In addition to the heating current, some 30 A on the reference board.
        machine.chip().pins.surge_a = 0.53e-3 * f64::from(TRIP_CURRENT_MA);
        machine.run_for(us(300)).unwrap();
        machine.chip().pins.surge_a = 0.0;
        assert_eq!(machine.chip().hrtim.off_at, None);
    });
}

#[test]
fn system_faults_open_the_bridge_and_are_told_apart() {
    type Cause = fn(&mut Machine);
    let causes: [(&str, Fault, Cause); 2] = [
        ("supply", Fault::SUPPLY_LOW, |machine| {
            machine.chip().set_supply_v(SAGGED_V);
        }),
        ("lock-up", Fault::CORE_LOCKUP, |machine| {
            machine.chip().system_fault(syscfg::cfgr2::CLL);
        }),
    ];
    for (name, fault, cause) in causes {
        let bench = heating();
        let off_us = time_to_off(&bench, 5, cause);
        println!("{name}: off after {off_us:.2} µs");
        assert!(off_us < 0.01, "{name}: {off_us}");
        assert_eq!(connect(&bench).status().unwrap().fault, fault, "{name}");
    }
}

/// RM0440, 27.3.22: an output that is enabled while a fault is active enters FAULT state; clearing the flag changes nothing.
#[test]
fn a_supply_that_stays_low_keeps_the_bridge_open_across_restarts() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let mut client = connect(&bench);
    client.set_power(1_200).unwrap();
    bench.run_s(0.2);
    let before = client.status().unwrap();
    assert_eq!(before.state, State::Heating);
    bench.with(|machine| {
        machine.chip().set_supply_v(SAGGED_V);
        machine.chip().hrtim.off_at = None;
    });
    // The first restart comes after 0.1 s, the next one 1 s later.
    for _ in 0..50 {
        bench.run_s(0.01);
        let bridge = bench.with(|machine| machine.chip().pins.bridge());
        assert_eq!(bridge, Bridge::Open);
    }
    let off_at = bench.with(|machine| machine.chip().hrtim.off_at);
    assert_eq!(off_at, None, "a switch closed in between");
    let status = client.status().unwrap();
    assert_eq!(status.fault, Fault::SUPPLY_LOW);
    assert!(before.tries_left - status.tries_left >= 2, "{status:?}");
    bench.with(|machine| machine.chip().set_supply_v(NOMINAL_SUPPLY_V));
    bench.run_s(1.2);
    assert_eq!(client.status().unwrap().state, State::Heating);
    assert_no_violations(&bench);
}

/// The flags of a fault outlast the burst in whose last block it came: the supply is low for 5 µs, while that block is processed.
#[test]
fn a_dip_at_the_end_of_a_pot_probe_is_reported() {
    let asked = || {
        let bench = with_pot(PotKind::None);
        connect(&bench).set_power(1_200).unwrap();
        bench
    };
    let first_end = asked().with(|machine| {
        machine.chip().hrtim.off_at = None;
        while machine.chip().hrtim.off_at.is_none() {
            machine.run_for(us(100)).unwrap();
        }
        machine.chip().hrtim.off_at.expect("a probe ended")
    });
    let bench = asked();
    let off_at = bench.with(move |machine| {
        machine.run_until(first_end - us(10)).unwrap();
        machine.chip().set_supply_v(SAGGED_V);
        machine.run_for(us(5)).unwrap();
        machine.chip().set_supply_v(NOMINAL_SUPPLY_V);
        machine.run_for(us(1_000)).unwrap();
        machine.chip().hrtim.off_at.expect("the outputs went off")
    });
    assert!((first_end - us(11)..first_end).contains(&off_at));
    let status = connect(&bench).status().unwrap();
    assert_eq!(status.fault, Fault::SUPPLY_LOW);
}

#[test]
fn errors_of_the_memories_open_the_bridge_and_are_reported_after_the_reset() {
    type Cause = fn(&mut Machine);
    let causes: [(&str, Field, Fault, Cause); 2] = [
        ("flash", syscfg::cfgr2::ECCL, Fault::FLASH_ECC, |machine| {
            machine.chip().file.set(flash::flash_eccr::ECCD, 1);
        }),
        ("parity", syscfg::cfgr2::SPL, Fault::RAM_PARITY, |machine| {
            machine.chip().file.set(syscfg::cfgr2::SPF, 1);
        }),
    ];
    for (name, connected_by, fault, cause) in causes {
        let bench = heating();
        let off_us = time_to_off(&bench, 1, move |machine| {
            cause(machine);
            machine.chip().system_fault(connected_by);
            machine.chip().nvic.pend(NMI);
        });
        println!("{name}: off after {off_us:.2} µs");
        assert!(off_us < 0.01, "{name}: {off_us}");
        assert_eq!(after_reset(&bench), (2, fault.number()), "{name}");
    }
}

/// Holds the thread in `b .` at the bottom of the stack, which was never used.
fn hold_thread(machine: &mut Machine) {
    machine.set_memory(0x2000_0100, &0xE7FEu16.to_le_bytes());
    machine.set_pc(0x2000_0100);
}

#[test]
fn a_thread_that_stands_still_is_reset_by_the_watchdog() {
    let bench = heating();
    let off_us = time_to_off(&bench, 100, |machine| {
        reach_thread(machine);
        hold_thread(machine);
    });
    println!("thread stands still: off after {:.1} ms", off_us / 1e3);
    assert!(off_us < 66_000.0, "{off_us}");
    assert_eq!(resets(&bench), [Reset::Watchdog]);
    assert_eq!(after_reset(&bench).0, 1);
}

/// Thread that never gets to feed the watchdog: its counter starts from 0xFFF, 512 ms, if it is not reloaded (RM0440, 44.3).
#[test]
fn a_thread_that_stands_still_from_the_start_is_reset_by_the_watchdog() {
    let bench = with_pot(PotKind::Ferromagnetic);
    let reset_s = bench.with(|machine| {
        let runs = |chip: &Chip| chip.hrtim.is_running() && chip.watchdog.bites_at.is_some();
        while !runs(machine.chip()) {
            machine.run_for(us(100)).unwrap();
        }
        reach_thread(machine);
        hold_thread(machine);
        let began = machine.now();
        while machine.resets.is_empty() && machine.now() < began + us(600_000) {
            machine.run_for(us(1_000)).unwrap();
        }
        seconds(machine.now() - began)
    });
    println!("thread stands still from the start: reset after {reset_s:.3} s");
    assert_eq!(resets(&bench), [Reset::Watchdog]);
    assert!(reset_s < 0.066, "{reset_s}");
}

/// Clears a bit by a write, as the program could.
fn clear(machine: &mut Machine, bit: Field) {
    let without = bit.put(machine.chip().file.word(bit.address), 0);
    machine.chip().write(bit.address, 4, without);
}

/// Any end of the sampling: the sampling watchdog opens the bridge in hardware 0.5 ms after the last block.
#[test]
fn sampling_that_stops_opens_the_bridge_in_hardware() {
    type Cause = fn(&mut Machine);
    let causes: [(&str, Cause); 3] = [
        ("no triggers", |machine| {
            clear(machine, hrtim_common::adc1r::AD1TBC3)
        }),
        ("DMA stopped", |machine| clear(machine, dma1::ccr1::EN)),
        // NVIC_ICER0: DMA1's first channel is interrupt 11.
        ("interrupt masked", |machine| {
            machine.chip().write_system(0xE180, 4, 1 << 11)
        }),
    ];
    for (name, cause) in causes {
        let bench = heating();
        let off_us = time_to_off(&bench, 1, cause);
        println!("{name}: off after {off_us:.0} µs");
        // The last block ended at most 50 µs before, or is being processed for 30 µs.
        assert!((430.0..=535.0).contains(&off_us), "{name}: {off_us}");
    }
}

/// RM0440, "Managing conversions using the DMA": after an overrun the DMA gets nothing more from that ADC. Pairs and blocks go on.
#[test]
fn a_bus_and_mains_reading_that_stops_opens_the_bridge_and_restarts() {
    type Cause = fn(&mut Machine);
    let causes: [(&str, Cause); 2] = [
        ("overrun", |machine| machine.chip().late_transfers = 1),
        // The hardware clears EN (RM0440, "DMA error management").
        ("transfer error", |machine| clear(machine, dma1::ccr2::EN)),
    ];
    for (name, cause) in causes {
        let bench = heating();
        let off_us = time_to_off(&bench, 100, cause);
        println!("{name} of bus and mains: off after {off_us:.0} µs");
        assert!(off_us < 600.0, "{name}: {off_us}");
        assert_eq!(resets(&bench), [Reset::Watchdog], "{name}");
        assert_eq!(after_reset(&bench), (1, Fault::SAMPLES_LOST.number()));
        let mut client = connect(&bench);
        client.set_power(1_200).unwrap();
        bench.run_s(0.5);
        assert_eq!(client.status().unwrap().state, State::Heating, "{name}");
    }
}

#[test]
fn sampling_that_stops_for_a_while_is_a_fault_with_its_number() {
    let bench = heating();
    let off_us = time_to_off(&bench, 1, |machine| {
        machine.chip().write_system(0xE180, 4, 1 << 11);
    });
    assert!(off_us <= 535.0, "{off_us}");
    // NVIC_ISER0.
    bench.with(|machine| machine.chip().write_system(0xE100, 4, 1 << 11));
    let status = connect(&bench).status().unwrap();
    assert_eq!(status.fault, Fault::SAMPLES_LOST);
}

/// Interrupts that are masked for less than the watchdog's time have no effect.
#[test]
fn a_short_delay_of_the_sampling_does_not_trip() {
    let bench = heating();
    bench.with(|machine| {
        machine.chip().hrtim.off_at = None;
        for _ in 0..20 {
            machine.chip().write_system(0xE180, 4, 1 << 11);
            machine.run_for(us(35)).unwrap();
            machine.chip().write_system(0xE100, 4, 1 << 11);
            machine.run_for(us(1_000)).unwrap();
        }
        assert_eq!(machine.chip().hrtim.off_at, None);
    });
}

#[test]
fn a_panic_a_processor_fault_and_a_stack_overflow_end_with_the_outputs_off() {
    type Cause = fn(&mut Machine);
    let causes: [(&str, u8, Cause); 3] = [
        ("panic", 2, |machine| {
            let panic = machine
                .image()
                .symbol_like("panicking9panic_fmt")
                .expect("a panic in the image");
            machine.set_pc(panic);
        }),
        // There is no code at this address.
        ("processor fault", 2, |machine| machine.set_pc(0x0900_0000)),
        // The next interrupt's frame no longer fits below this.
        ("stack overflow", 6, |machine| machine.set_sp(0x2000_0010)),
    ];
    for (name, reason, cause) in causes {
        let bench = heating();
        let off_us = time_to_off(&bench, 1, move |machine| {
            reach_thread(machine);
            cause(machine);
        });
        println!("{name}: off after {off_us:.2} µs");
        // The thread sleeps until the next block, at most 42 µs, whose interrupt takes at most as long.
        assert!(off_us < 84.0, "{name}: {off_us}");
        assert_eq!(after_reset(&bench).0, reason, "{name}");
    }
}

/// The MPU's fault comes as the frame is pushed. Without it that write is ignored (`map_below_ram`), and the handler runs without a stack.
#[test]
fn a_stack_that_overflows_ends_before_another_handler_runs() {
    let bench = heating();
    let handlers = bench.with(|machine| {
        reach_thread(machine);
        machine.set_sp(0x2000_0010);
        machine.chip().hrtim.off_at = None;
        let before = machine.chip().nvic.entries[SAMPLING];
        while machine.chip().hrtim.off_at.is_none() {
            machine.run_for(500).unwrap();
        }
        machine.chip().nvic.entries[SAMPLING] - before
    });
    assert_eq!(handlers, 0);
    assert_eq!(after_reset(&bench).0, 6);
}

/// Ends the program by a panic, some time after its start.
fn panic_soon(bench: &Bench) {
    bench.run_s(0.05);
    bench.with(|machine| {
        reach_thread(machine);
        let panic = machine.image().symbol_like("panicking9panic_fmt");
        machine.set_pc(panic.expect("a panic in the image"));
    });
}

/// After five ends in a row the program stays stopped, and so does the interrupt that could close a switch. A supply that sags, with its
/// RAM intact, does not end the count of ends.
#[test]
fn a_program_that_ends_again_and_again_stays_with_its_interrupts_masked() {
    let bench = with_pot(PotKind::Ferromagnetic);
    for _ in 0..4 {
        panic_soon(&bench);
    }
    bench.run_s(0.05);
    bench.with(|machine| machine.chip().reset = Some(Reset::Power));
    panic_soon(&bench);
    bench.run_s(0.2);
    let before = [Reset::Software; 4];
    assert_eq!(resets(&bench), [&before[..], &[Reset::Power]].concat());
    for _ in 0..10 {
        bench.run_s(0.001);
        let waits = bench.with(|machine| machine.chip().nvic.next(false, 0).is_some());
        assert!(waits, "the sampling interrupt is held off");
    }
    let bridge = bench.with(|machine| machine.chip().pins.bridge());
    assert_eq!(bridge, Bridge::Open);
}

/// Without mains, fault 10 is active in each run, which locks nothing out: it is there for the LED, and for the log after the reset that
/// ends it.
#[test]
fn a_watchdog_that_bites_again_and_again_leaves_the_fault_of_the_last_run() {
    let bench = with_pot(PotKind::Ferromagnetic);
    set_mains(&bench, 0.0);
    for bites in 1..=5 {
        bench.with(move |machine| {
            reach_thread(machine);
            machine.run_for(us(60_000)).unwrap();
            reach_thread(machine);
            hold_thread(machine);
            let began = machine.now();
            while machine.resets.len() < bites && machine.now() < began + us(600_000) {
                machine.run_for(us(1_000)).unwrap();
            }
        });
    }
    bench.run_s(0.1);
    assert_eq!(resets(&bench), [Reset::Watchdog; 5]);
    bench.with(|machine| machine.chip().reset = Some(Reset::Software));
    assert_eq!(after_reset(&bench), (5, Fault::MAINS_LOST.number()));
}

#[test]
fn blocks_that_are_lost_open_the_bridge() {
    let bench = heating();
    let off_us = time_to_off(&bench, 100, |machine| {
        machine.set_cycle_model(CycleModel::PerInstruction(6))
    });
    println!("blocks lost: off after {:.2} ms", off_us / 1e3);
    assert!(off_us < 25_000.0, "{off_us}");
}
