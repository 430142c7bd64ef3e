//! `ihd watch` on a pseudo-terminal, as a person at the bench has it.

use ihd_fakes::free_address;

use super::processes::{Kitchen, ihd, outcome};
use super::screen::Screen;

fn watch(kitchen: &Kitchen, more: &[&str]) -> Screen {
    let config = kitchen.dir.path().join("ihd.toml");
    let mut command = ihd();
    command.arg("watch").args(more).arg("--config").arg(config);
    Screen::start(&mut command)
}

/// The number before `unit` in the line of the chosen device.
fn number_before(text: &str, unit: &str) -> Option<f64> {
    let (before, _) = text.split_once(unit)?;
    before.split_whitespace().last()?.parse().ok()
}

#[test]
fn a_person_sees_it_heat_and_switches_it_off() {
    let kitchen = Kitchen::start();
    let heating = kitchen.in_the_background(&["bench", "power", "1200"]);
    let mut screen = watch(&kitchen, &[]);
    let text = screen.until("it heats", |text| {
        text.contains("learning") && number_before(text, " Ω,").is_some()
    });
    assert!(text.contains("of 1200 W asked"), "{text}");
    assert!(text.contains("Ferromagnetic"), "{text}");
    assert!(text.contains("commands it"), "{text}");
    // Of the default pot: R and L are within what it can have at 20 to 80 kHz.
    let r_ohm = number_before(&text, " Ω,").unwrap();
    let (_, after_r) = text.split_once(" Ω,").unwrap();
    let l_uh = number_before(after_r, " µH").unwrap();
    assert!((1.0..6.0).contains(&r_ohm), "{r_ohm}\n{text}");
    assert!((10.0..40.0).contains(&l_uh), "{l_uh}\n{text}");
    screen.until("a window is learned from", |text| text.contains("window "));
    // The lease is another's; off needs none.
    screen.press(b"o");
    screen.until("it is off", |text| text.contains("of 0 W asked"));
    kitchen.until("the device itself is off", |report| {
        report["live"]["f_sw_hz"] == 0 && report["asked_by_daemon_w"] == 0
    });
    screen.press(b"q");
    assert_eq!(screen.ended(), 0);
    drop(heating);
}

#[test]
fn a_daemon_that_ends_is_told_and_comes_back_by_itself() {
    let mut kitchen = Kitchen::start();
    let screen = watch(&kitchen, &["bench"]);
    screen.until("it is seen", |text| text.contains("bench: idle"));
    kitchen.daemon.signal("KILL");
    screen.until("it is gone", |text| text.contains("NO DAEMON"));
    kitchen.start_daemon_again();
    let back = screen.until("it is back", |text| {
        !text.contains("NO DAEMON") && text.contains("the daemon is back")
    });
    assert!(back.contains("bench: "), "{back}");
    // Ended from outside, too, it leaves the terminal as it was.
    screen.terminate();
    assert_eq!(screen.ended(), 0);
}

#[test]
fn without_a_terminal_a_device_or_a_daemon_it_says_what_to_do() {
    let kitchen = Kitchen::start();
    let config = kitchen.dir.path().join("ihd.toml");
    let mut command = ihd();
    command.args(["watch", "bench", "--config"]).arg(&config);
    let (code, _, stderr) = outcome(command.output().unwrap());
    assert_eq!(code, 2, "{stderr}");
    assert!(stderr.contains("ihd watch bench --lines"), "{stderr}");

    let screen = watch(&kitchen, &["nobody"]);
    let text = screen.until("it says so", |text| text.contains("nobody"));
    assert!(text.contains("ihd device status"), "{text}");
    assert_eq!(screen.ended(), 2);

    let other = kitchen.dir.path().join("other.toml");
    std::fs::write(&other, format!("listen = \"{}\"\n", free_address())).unwrap();
    let mut command = ihd();
    command.arg("watch").arg("--config").arg(other);
    let screen = Screen::start(&mut command);
    screen.until("it says so", |text| text.contains("start one with"));
    assert_eq!(screen.ended(), 3);
}
