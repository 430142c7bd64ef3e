//! Checks of the last start and of the identity of chip and program.

use ihd_flash::OptionBytes;
use ihd_link::{BoardFacts, Client};
use ihd_shared::fault::Fault;
use ihd_shared::image::{DEVICE_ID, FLASH_KIB};
use ihd_shared::wire::messages::{Hello, Status};

use crate::check_session::CheckSession;
use crate::{Check, Measurement};

/// Examines how the device started and what it is; returns its identity, `None` if there is no answer.
pub(super) fn examine(
    session: &mut CheckSession<'_>,
    hello: &Hello,
    status: Option<&Status>,
) -> Option<BoardFacts> {
    // Checks without a request do not depend on the link.
    session.add(reset_cause(hello));
    match status {
        Some(status) => session.add(fault(status)),
        None => session.add(Check::not_tested("fault", "the device did not report it")),
    }
    let facts = session.check_answer("chip", Client::board);
    match &facts {
        Some(facts) => {
            session.add(chip(facts));
            session.add(option_bytes(facts));
            session.add(flash_crc(facts));
        }
        None => {
            for name in ["option_bytes", "flash_crc"] {
                session.add(Check::not_tested(name, "the device did not report it"));
            }
        }
    }
    facts
}

/// Checks the reason of the last start, and the fault before it.
fn reset_cause(hello: &Hello) -> Check {
    const NAME: &str = "reset_cause";
    let before = Fault::from_number(hello.fault_before_reset);
    let words = match before {
        Fault::NONE => String::new(),
        fault => format!(", before it fault {}", fault),
    };
    let (reason, remedy) = match hello.reset_reason {
        0 => ("power-on", None),
        4 => ("NRST", None),
        5 => ("software, or a debugger", None),
        1 => (
            "the watchdog",
            Some("A task stood still. Keep the image, read ihd log, report it"),
        ),
        2 => ("a panic", Some("Keep the image, read ihd log, report it")),
        3 => (
            "a brown-out",
            Some("Look at the supply: 3.3 V must not fall below 2.9 V"),
        ),
        6 => (
            "a stack overflow",
            Some("Keep the image, read ihd log, report it"),
        ),
        _ => (
            "a reason that this host does not know",
            Some("A newer host knows it"),
        ),
    };
    match remedy {
        None => Check::pass(NAME, format!("started by {reason}{words}")),
        Some(remedy) => Check::fail(NAME, format!("started by {reason}{words}"), remedy),
    }
}

/// Checks the active fault.
fn fault(status: &Status) -> Check {
    const NAME: &str = "fault";
    match status.fault {
        Fault::NONE => Check::pass(NAME, "none"),
        // Expected on a bench without mains.
        Fault::MAINS_LOST => {
            Check::not_tested(NAME, "10, no mains: nothing else is seen before there is")
                .with_remedy(
                    "On a bench: 24 V~ on L and N, or a generator on PB0 (docs/bring-up.md)",
                )
        }
        fault => Check::fail(
            NAME,
            fault.to_string(),
            "docs/bring-up.md has the table of faults",
        ),
    }
}

/// Checks the type of the chip.
fn chip(facts: &BoardFacts) -> Check {
    const NAME: &str = "chip";
    if facts.id_code == 0 {
        return Check::not_tested(NAME, "the device has no chip: it is simulated");
    }
    let finding = format!(
        "id {:#05x}, revision {:#06x}, {} KiB of flash, number {}",
        facts.id_code & 0xFFF,
        facts.id_code >> 16,
        facts.flash_kib,
        facts.chip_number()
    );
    let numbers = vec![
        Measurement::informative("starts since power-on", facts.starts.into(), ""),
        Measurement::informative("image", facts.image_bytes.into(), "bytes"),
    ];
    if facts.id_code & 0xFFF == DEVICE_ID && facts.flash_kib == FLASH_KIB {
        return Check::pass(NAME, finding).with_evidence(numbers);
    }
    let remedy = "The firmware is for an STM32G474 with 512 KiB; what runs on another is untested";
    Check::fail(NAME, finding, remedy).with_evidence(numbers)
}

/// Compares FLASH_OPTR with the firmware's requirements.
fn option_bytes(facts: &BoardFacts) -> Check {
    const NAME: &str = "option_bytes";
    // The device does not report write protection: 0 would be page 0 of each bank.
    let options = OptionBytes {
        optr: facts.option_bytes,
        ..OptionBytes::default()
    };
    let deviations = options.deviations();
    let text = |needed: bool| -> Vec<String> {
        let of = deviations.iter().filter(|d| d.needed == needed);
        of.map(|d| {
            format!(
                "{} is {} instead of {} ({})",
                d.name, d.is, d.required, d.why
            )
        })
        .collect()
    };
    let (needed, advised) = (text(true), text(false));
    let finding = format!("FLASH_OPTR {:#010x}", facts.option_bytes);
    let remedy = "ihd flash --set-option-bytes";
    match (needed.is_empty(), advised.is_empty()) {
        (true, true) => Check::pass(NAME, format!("{finding}, as the firmware wants them")),
        (true, false) => Check::pass(
            NAME,
            format!("{finding}; with less margin: {}", advised.join("; ")),
        )
        .with_remedy(remedy),
        _ => Check::fail(NAME, [needed, advised].concat().join("; "), remedy),
    }
}

/// Checks the program in flash against its own CRC.
fn flash_crc(facts: &BoardFacts) -> Check {
    const NAME: &str = "flash_crc";
    if facts.image_bytes == 0 {
        return Check::not_tested(NAME, "the device has no program in flash: it is simulated");
    }
    let finding = format!(
        "{:#010x} over {} bytes, sealed with {:#010x}",
        facts.image_crc, facts.image_bytes, facts.sealed_crc
    );
    match facts.image_crc == facts.sealed_crc {
        true => Check::pass(NAME, finding),
        false => Check::fail(
            NAME,
            finding,
            "ihd flash; comes it back, another controller",
        ),
    }
}
