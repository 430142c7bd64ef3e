//! Wrong values in single fields of a healthy board: each is reported, or has the effect that it has on the chip. What the emulated
//! chip did not look at, wrong firmware could get wrong.

use ihd_shared::board::{LIGHT_POWER_PIN, SHARE_WIRE_PIN};
use ihd_sim::behavioural::PotKind;
use ihd_sim::front_end::NOMINAL_SUPPLY_V;
use ihd_sim::injection::DETECTOR_V;
use ihd_stm32g474::chip::Chip;
use ihd_stm32g474::registers::{
    Field, adc1, adc2, adc3, adc12_common, comp, dac1, dma1, gpioa, hrtim_common, hrtim_master,
    hrtim_tima, hrtim_timb, lpuart1, pwr, rcc, rng, usb_fs_device,
};
use ihd_stm32g474::time::us;

use crate::board::{connect, with_pot};

/// Field, wrong value, and part of the rule that reports it.
type Reported = (Field, u32, &'static str);

const BEFORE_OUTPUTS: [Reported; 15] = {
    use hrtim_common::fltinr1::{FLT1E, FLT2E, FLT4E};
    use hrtim_tima::dtar::{DTFX, DTRX, SDTFX, SDTRX};
    use hrtim_tima::fltar::FLT4EN;
    use hrtim_tima::outar::{DTEN, FAULT1, FAULT2, IDLES1, IDLES2, POL1, POL2};
    [
        (DTRX, 0, "without dead time"),
        (DTFX, 0, "without dead time"),
        (DTEN, 0, "without dead time"),
        (SDTRX, 1, "negative dead time"),
        (SDTFX, 1, "negative dead time"),
        (POL1, 1, "inverted"),
        (POL2, 1, "inverted"),
        (IDLES1, 1, "active while idle"),
        (IDLES2, 1, "active while idle"),
        (FAULT1, 1, "fault state"),
        (FAULT2, 3, "fault state"),
        (FLT1E, 0, "fault input 1"),
        (FLT2E, 0, "fault input 2"),
        (FLT4E, 0, "fault input 4"),
        (FLT4EN, 0, "fault input 4"),
    ]
};

/// Brings the dead time into force, and enables the outputs for a moment.
fn enable_outputs(chip: &mut Chip) {
    use hrtim_common::{cr2, odisr, oenr};
    chip.write(cr2::ADDRESS, 4, cr2::TASWU.mask() | cr2::TBSWU.mask());
    chip.write(oenr::ADDRESS, 4, 3);
    chip.write(odisr::ADDRESS, 4, 3);
}

const BEFORE_CONVERSIONS: [Reported; 6] = {
    use adc12_common::ccr::{DMACFG, MDMA};
    [
        (MDMA, 0, "MDMA"),
        (DMACFG, 0, "DMACFG"),
        (adc3::cfgr::DMACFG, 0, "DMACFG"),
        (dma1::cpar1::PA, adc1::dr::ADDRESS, "CPAR"),
        (dma1::cpar2::PA, adc1::dr::ADDRESS, "CPAR"),
        (adc2::smpr1::SMP2, 1, "different times"),
    ]
};

fn convert(chip: &mut Chip) {
    pass(chip, 3);
}

const BEFORE_USB: [Reported; 2] = [
    (rcc::rcc_ccipr::CLK48SEL, 2, "USB without 48 MHz"),
    (rcc::rcc_crrcr::HSI48ON, 0, "USB without 48 MHz"),
];

fn read_usb_frame(chip: &mut Chip) {
    chip.read(usb_fs_device::fnr::ADDRESS, 4);
}

const BEFORE_NOISE: [Reported; 2] = [
    (rcc::rcc_ccipr::CLK48SEL, 2, "RNG without 48 MHz"),
    (rcc::rcc_crrcr::HSI48RDY, 0, "RNG without 48 MHz"),
];

fn start_random(chip: &mut Chip) {
    chip.file.set(rcc::rcc_ahb2enr::RNGEN, 1);
    chip.write(rng::cr::ADDRESS, 4, rng::cr::RNGEN.mask());
}

const BEFORE_WIRE: [Reported; 1] = [(
    Field::new(
        of_port(gpioa::otyper::ADDRESS, SHARE_WIRE_PIN.port),
        SHARE_WIRE_PIN.line as u32,
        1,
    ),
    0,
    "without open drain",
)];

/// Writes the wire's port as it is.
fn write_wire(chip: &mut Chip) {
    let address = of_port(gpioa::otyper::ADDRESS, SHARE_WIRE_PIN.port);
    chip.write(address, 4, chip.file.word(address));
}

/// Fields of the counters; last, as these begin anew beside conversions under way.
const BEFORE_COUNTERS: [Reported; 4] = [
    (hrtim_tima::timacr::CONT, 0, "CONT"),
    (hrtim_timb::timbcr::CONT, 0, "CONT"),
    (hrtim_tima::timacr::CK_PSCX, 1, "prescaler"),
    (hrtim_timb::timbcr::CK_PSCX, 1, "prescaler"),
];

fn restart_counters(chip: &mut Chip) {
    use hrtim_master::mcr::{ADDRESS, TACEN, TBCEN};
    let running = chip.file.word(ADDRESS);
    chip.write(ADDRESS, 4, running & !(TACEN.mask() | TBCEN.mask()));
    chip.write(ADDRESS, 4, running);
}

/// Address of a port's register, by that of port A.
const fn of_port(of_port_a: u32, port: u8) -> u32 {
    of_port_a + 0x400 * port as u32
}

/// Lets the chip run for some microseconds, without its processor.
fn pass(chip: &mut Chip, microseconds: u64) {
    chip.log.now += us(microseconds);
    chip.advance();
}

/// Rules that `act` breaks with another value in a field; all registers are as before afterwards.
fn broken_by(chip: &mut Chip, wrong: Option<(Field, u32)>, act: fn(&mut Chip)) -> Vec<String> {
    let healthy = chip.file.clone();
    set_wrong(chip, wrong);
    act(chip);
    chip.file = healthy;
    let broken = chip.log.violations.drain(..);
    broken.map(|violation| violation.rule).collect()
}

fn set_wrong(chip: &mut Chip, wrong: Option<(Field, u32)>) {
    if let Some((field, value)) = wrong {
        assert_ne!(chip.file.get(field), value, "{field:?} is so already");
        chip.file.set(field, value);
    }
}

#[test]
fn each_wrong_field_is_reported() {
    type Group = (fn(&mut Chip), &'static [Reported]);
    let groups: [Group; 6] = [
        (enable_outputs, &BEFORE_OUTPUTS),
        (read_usb_frame, &BEFORE_USB),
        (start_random, &BEFORE_NOISE),
        (write_wire, &BEFORE_WIRE),
        (convert, &BEFORE_CONVERSIONS),
        (restart_counters, &BEFORE_COUNTERS),
    ];
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(move |machine| {
        let chip = machine.chip();
        for (act, fields) in groups {
            assert_eq!(broken_by(chip, None, act), Vec::<String>::new());
            for &(field, value, rule) in fields {
                let broken = broken_by(chip, Some((field, value)), act);
                let is_reported = broken.iter().any(|one| one.contains(rule));
                assert!(is_reported, "{field:?} = {value}, {rule}: {broken:?}");
            }
        }
        // The slave's regulator off.
        chip.write(adc2::cr::ADDRESS, 4, 0);
        let broken = broken_by(chip, None, convert);
        let rule = "ADC2: a trigger came before ADRDY";
        assert!(broken.iter().any(|one| one.contains(rule)), "{broken:?}");
    });
}

/// Fields of a comparator's way to its fault input, 1 or 4, with values that lead it elsewhere.
const ON_THE_WAY: [(usize, Field, u32); 13] = {
    use comp::{comp_c1csr, comp_c2csr};
    use dac1::dac_mcr::{MODE1, MODE2};
    use hrtim_common::{fltinr1, fltinr2};
    [
        (1, comp_c2csr::INPSEL, 1),
        (1, comp_c2csr::POL, 1),
        (1, MODE2, 0),
        (1, fltinr1::FLT1P, 0),
        (1, fltinr1::FLT1SRC, 0),
        (1, fltinr2::FLT1SRC_1, 1),
        (4, comp_c1csr::INPSEL, 1),
        (4, comp_c1csr::POL, 1),
        (4, comp_c1csr::INMSEL, 4),
        (4, MODE1, 2),
        (4, fltinr1::FLT4P, 0),
        (4, fltinr1::FLT4SRC, 0),
        (4, fltinr2::FLT4SRC_1, 1),
    ]
};

/// Fault inputs that trip once both thresholds are at 0 V.
fn tripped(chip: &mut Chip, wrong: Option<(Field, u32)>) -> Vec<usize> {
    use hrtim_common::isr::{ADDRESS, FLT1, FLT4};
    let healthy = chip.file.clone();
    // Until the last trip has ended.
    pass(chip, 3);
    set_wrong(chip, wrong);
    chip.file.set_word(ADDRESS, 0);
    chip.file.set(dac1::dac_dhr12r1::DACC1DHR, 0);
    chip.file.set(dac1::dac_dhr12r2::DACC2DHR, 0);
    pass(chip, 20);
    let flags = [(1, FLT1), (4, FLT4)].into_iter();
    let set = flags.filter(|(_, flag)| chip.file.is(*flag));
    let inputs = set.map(|(input, _)| input).collect();
    chip.file = healthy;
    inputs
}

#[test]
fn a_comparator_that_is_led_elsewhere_does_not_trip() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(|machine| {
        let chip = machine.chip();
        assert_eq!(tripped(chip, None), [1, 4]);
        for (input, field, value) in ON_THE_WAY {
            let other = 5 - input;
            assert_eq!(tripped(chip, Some((field, value))), [other], "{field:?}");
        }
    });
}

#[test]
fn the_supplys_detector_has_the_level_that_is_set() {
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(|machine| {
        let chip = machine.chip();
        let healthy = chip.file.clone();
        for (level, supply_v, is_low) in [
            (6, NOMINAL_SUPPLY_V, false),
            (6, DETECTOR_V + 0.01, false),
            (6, DETECTOR_V - 0.01, true),
            (5, DETECTOR_V - 0.01, false),
            (0, 2.1, false),
            (7, 2.1, false),
        ] {
            chip.file.set(pwr::pwr_cr2::PVDLS, level);
            chip.set_supply_v(supply_v);
            let found = chip.file.is(pwr::pwr_sr2::PVDO);
            assert_eq!(found, is_low, "{level} at {supply_v} V");
            chip.file = healthy.clone();
        }
    });
}

/// Lines of GPIO and LPUART1 that are not led to their pins.
#[test]
fn a_line_in_another_mode_drives_and_carries_nothing() {
    use gpioa::{afrl, moder};
    let bench = with_pot(PotKind::Ferromagnetic);
    drop(connect(&bench));
    bench.with(|machine| {
        let chip = machine.chip();
        let healthy = chip.file.clone();
        for pin in [LIGHT_POWER_PIN, SHARE_WIRE_PIN] {
            let line = u32::from(pin.line);
            chip.file.set(
                Field::new(of_port(gpioa::odr::ADDRESS, pin.port), line, 1),
                1,
            );
            assert!(chip.driven(pin), "{pin:?}");
            let mode = Field::new(of_port(moder::ADDRESS, pin.port), 2 * line, 2);
            chip.file.set(mode, 0);
            assert!(!chip.driven(pin), "{pin:?}");
            chip.file = healthy.clone();
        }
        for (wrong, sent, received) in [
            (None, 1, 1),
            (Some((moder::MODER2, 1)), 0, 1),
            (Some((afrl::AFRL2, 7)), 0, 1),
            (Some((moder::MODER3, 0)), 1, 0),
            (Some((afrl::AFRL3, 7)), 1, 0),
        ] {
            set_wrong(chip, wrong);
            assert_eq!(exchanged(chip), [sent, received], "{wrong:?}");
            chip.file = healthy.clone();
        }
    });
}

/// Bytes of one each way that arrive at the other end.
fn exchanged(chip: &mut Chip) -> [u32; 2] {
    use lpuart1::{rdr, tdr};
    // What is under way: nine bytes at most.
    pass(chip, 120);
    while waiting(chip) == 1 {
        chip.read(rdr::ADDRESS, 4);
    }
    chip.serial.sent.clear();
    chip.serial.inbound.push_back(0x55);
    chip.write(tdr::ADDRESS, 4, 0x55);
    pass(chip, 40);
    [chip.serial.sent.len() as u32, waiting(chip)]
}

/// Bytes that wait to be read: 0 or 1.
fn waiting(chip: &mut Chip) -> u32 {
    use lpuart1::isr;
    isr::RXNE.extract(chip.read(isr::ADDRESS, 4))
}
