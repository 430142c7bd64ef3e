//! The checks on machines that are told what they have; files under a folder of the test's own.

use std::fs;
use std::io::{self, ErrorKind};
use std::path::Path;

use super::fake::{FakeSystem, device, port, stlink};
use super::*;
use crate::CheckResult;

fn found(system: &FakeSystem, name: &str) -> Check {
    let mut all = checks(system).into_iter();
    let found = all.find(|check| check.name == name);
    found.unwrap_or_else(|| panic!("no check {name}"))
}

fn current() -> Vec<(String, String)> {
    vec![(RULE_NAME.into(), RULE.into())]
}

#[test]
fn an_empty_machine_fails_nothing_but_the_rule() {
    let checks = checks(&FakeSystem::default());
    let failed: Vec<_> = checks
        .iter()
        .filter(|c| c.verdict == CheckResult::Fail)
        .map(|c| c.name)
        .collect();
    assert_eq!(failed, ["udev_rule"]);
    assert!(boards(&FakeSystem::default()).is_empty());
}

#[test]
fn a_set_up_machine_with_a_nucleo_passes() {
    let system = FakeSystem {
        usb: vec![stlink()],
        ports: vec![port("/dev/ttyACM0", stlink())],
        rules: current(),
        modem_manager: true,
        ..FakeSystem::default()
    };
    for check in checks(&system) {
        assert_ne!(check.verdict, CheckResult::Fail, "{check:?}");
    }
    assert_eq!(boards(&system), ["serial:/dev/ttyACM0"]);
    let ports = found(&system, "serial_ports");
    assert_eq!(ports.finding, "/dev/ttyACM0 of the ST-LINK");
}

#[test]
fn a_board_of_its_own_socket_counts_before_a_probe_s_port() {
    let board = device(0x1209, 1, "ihd induction-hob controller", "A1");
    let system = FakeSystem {
        usb: vec![stlink(), board.clone()],
        ports: vec![port("/dev/ttyACM0", stlink())],
        ..FakeSystem::default()
    };
    assert_eq!(boards(&system), ["usb:A1"]);
    let second = UsbDevice {
        serial: "B2".into(),
        ..board.clone()
    };
    let two = FakeSystem {
        usb: vec![board, second],
        ..FakeSystem::default()
    };
    assert_eq!(boards(&two), ["usb:A1", "usb:B2"]);
}

#[test]
fn each_refusal_has_its_own_remedy() {
    let system = |refuses| FakeSystem {
        usb: vec![stlink()],
        ports: vec![port("/dev/ttyACM3", stlink())],
        usb_refuses: Some(refuses),
        port_refuses: Some(refuses),
        ..FakeSystem::default()
    };
    let denied = system(ErrorKind::PermissionDenied);
    let remedy = |system: &FakeSystem, name| found(system, name).remedy.unwrap();
    assert!(remedy(&denied, "usb_access").contains("sudo ihd doctor --fix"));
    assert!(remedy(&denied, "serial_access").contains("usermod -aG dialout"));
    let busy = system(ErrorKind::ResourceBusy);
    for name in ["usb_access", "serial_access"] {
        assert!(remedy(&busy, name).contains("Another program"), "{name}");
        assert_eq!(found(&busy, name).verdict, CheckResult::Fail);
    }
    assert!(found(&busy, "serial_access").finding.contains("ttyACM3"));
}

#[test]
fn a_chip_in_its_bootloader_is_told_what_to_do() {
    let system = FakeSystem {
        usb: vec![device(0x0483, 0xDF11, "STM32  BOOTLOADER", "207")],
        ..FakeSystem::default()
    };
    let check = found(&system, "bootloader");
    assert_eq!(check.verdict, CheckResult::Fail);
    assert!(check.remedy.unwrap().contains("ihd flash --dfu"));
}

#[test]
fn the_rule_is_missing_old_too_late_or_current() {
    let with = |rules| FakeSystem {
        rules,
        ..FakeSystem::default()
    };
    let rule = |rules| found(&with(rules), "udev_rule");
    assert_eq!(rule(vec![]).finding, "not installed");
    let late = rule(vec![("99-ihd.rules".into(), RULE.into())]);
    assert!(late.finding.contains("no effect"), "{}", late.finding);
    let old = rule(vec![(RULE_NAME.into(), "SUBSYSTEM==\"usb\"".into())]);
    assert!(old.finding.contains("not that of this version"));
    for check in [late, old] {
        assert_eq!(check.verdict, CheckResult::Fail);
        assert_eq!(check.remedy.as_deref(), Some("sudo ihd doctor --fix"));
    }
    // What a person added as a comment changes nothing; nor does a rule of a package beside it.
    let commented = format!("# mine\n\n{RULE}");
    let both = vec![
        (RULE_NAME.into(), commented),
        ("99-ihd.rules".into(), RULE.into()),
    ];
    assert_eq!(rule(both).verdict, CheckResult::Pass);
    let no_udev = FakeSystem {
        udev: false,
        ..FakeSystem::default()
    };
    assert_eq!(found(&no_udev, "udev_rule").verdict, CheckResult::NotTested);
}

#[test]
fn modem_manager_is_a_failure_only_where_it_can_reach_a_port() {
    let system = |rules, ports| FakeSystem {
        rules,
        ports,
        modem_manager: true,
        ..FakeSystem::default()
    };
    let ports = vec![port("/dev/ttyACM0", stlink())];
    let verdict = |system: FakeSystem| found(&system, "modem_manager").verdict;
    assert_eq!(verdict(system(vec![], ports.clone())), CheckResult::Fail);
    assert_eq!(verdict(system(current(), ports)), CheckResult::Pass);
    assert_eq!(verdict(system(vec![], vec![])), CheckResult::Pass);
}

#[test]
fn windows_is_asked_for_its_driver() {
    let board = |driver: Option<&str>| FakeSystem {
        os: Os::Windows,
        usb: vec![UsbDevice {
            driver: driver.map(str::to_owned),
            ..device(0x1209, 1, "ihd induction-hob controller", "A1")
        }],
        ..FakeSystem::default()
    };
    assert_eq!(
        found(&board(Some("WINUSB")), "usb_driver").verdict,
        CheckResult::Pass
    );
    assert_eq!(found(&board(None), "usb_driver").verdict, CheckResult::Fail);
    let names: Vec<_> = checks(&board(None)).iter().map(|c| c.name).collect();
    assert!(!names.contains(&"modem_manager"), "{names:?}");
}

#[test]
fn a_machine_without_usb_says_so_and_a_hostile_name_is_escaped() {
    let hidden = FakeSystem {
        usb_hidden: true,
        ..FakeSystem::default()
    };
    assert_eq!(
        found(&hidden, "debug_probe").verdict,
        CheckResult::NotTested
    );
    let hostile = FakeSystem {
        usb: vec![device(0x0483, 0x374B, "x", "\u{1b}[2J\n")],
        ..FakeSystem::default()
    };
    let finding = found(&hostile, "debug_probe").finding;
    assert!(!finding.chars().any(char::is_control), "{finding}");
}

/// sysfs as of a NUCLEO: a port, its interface, its device.
#[cfg(unix)]
#[test]
fn sysfs_tells_whose_port_it_is() {
    let root = tempfile::tempdir().unwrap();
    let usb = root.path().join("sys/devices/pci0/usb3/3-1");
    let tty = usb.join("3-1:1.2/tty/ttyACM0");
    let class = root.path().join("sys/class/tty");
    let dev = root.path().join("dev");
    for folder in [&tty, &class, &dev, &root.path().join("etc")] {
        fs::create_dir_all(folder).unwrap();
    }
    for (name, content) in [
        ("idVendor", "0483\n"),
        ("idProduct", "374e\n"),
        ("serial", "0045\n"),
        ("product", "STLINK-V3\n"),
    ] {
        fs::write(usb.join(name), content).unwrap();
    }
    std::os::unix::fs::symlink("../..", tty.join("device")).unwrap();
    std::os::unix::fs::symlink(&tty, class.join("ttyACM0")).unwrap();
    fs::create_dir_all(class.join("tty0")).unwrap();
    fs::write(dev.join("ttyACM0"), "").unwrap();
    let gid = {
        use std::os::unix::fs::MetadataExt;
        fs::metadata(dev.join("ttyACM0")).unwrap().gid()
    };
    fs::write(
        root.path().join("etc/group"),
        format!("other:x:99999:\nuucp:x:{gid}:me\n"),
    )
    .unwrap();
    let here = LocalSystem::with_root(root.path().to_owned(), String::new());
    let ports = here.ports_of_sysfs().unwrap();
    assert_eq!(
        ports,
        [Port {
            path: "/dev/ttyACM0".into(),
            usb: Some(stlink()),
            group: Some("uucp".into()),
        }]
    );
}

#[test]
fn processes_are_known_by_their_names() {
    let root = tempfile::tempdir().unwrap();
    for (folder, name) in [("12", "systemd"), ("371", "ModemManager"), ("self", "x")] {
        let folder = root.path().join("proc").join(folder);
        fs::create_dir_all(&folder).unwrap();
        fs::write(folder.join("comm"), format!("{name}\n")).unwrap();
    }
    let here = LocalSystem::with_root(root.path().to_owned(), String::new());
    assert!(here.runs("ModemManager"));
    assert!(!here.runs("x"), "no process");
    assert!(!here.runs("Modem"));
}

fn rules_of(root: &Path) -> Vec<(String, String)> {
    LocalSystem::with_root(root.to_owned(), String::new())
        .rules()
        .unwrap()
}

#[test]
fn the_rule_is_installed_once_and_replaces_the_one_without_effect() {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("etc/udev/rules.d");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("99-ihd.rules"), "old").unwrap();
    fs::write(folder.join("10-mine.rules"), "mine").unwrap();
    let mut ran = Vec::new();
    let mut run = |program: &str, arguments: &[&str]| -> io::Result<()> {
        ran.push(format!("{program} {}", arguments.join(" ")));
        Ok(())
    };
    for _ in 0..2 {
        let path = install(root.path(), "sudo x", &mut run).unwrap();
        assert_eq!(path, folder.join(RULE_NAME));
        assert_eq!(rules_of(root.path()), current());
    }
    assert!(folder.join("10-mine.rules").exists());
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 2, "no leftovers");
    assert_eq!(ran.len(), 4);
    assert!(ran[0].starts_with("udevadm control") && ran[1].starts_with("udevadm trigger"));
}

#[test]
fn a_rule_that_may_not_be_written_names_the_sudo_line() {
    let root = tempfile::tempdir().unwrap();
    // A file where the folder should be fails for root too.
    fs::write(root.path().join("etc"), "").unwrap();
    let mut none = |_: &str, _: &[&str]| -> io::Result<()> { panic!("udev is told of nothing") };
    let error = install(root.path(), "sudo ihd doctor --fix", &mut none).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains("sudo ihd doctor --fix") && text.contains("70-ihd"),
        "{text}"
    );
}

#[test]
fn the_file_of_the_docs_is_the_rule_and_names_every_kind() {
    for id in [
        "1209",
        "0483",
        "df11",
        "1366",
        "CMSIS-DAP",
        "ID_MM_DEVICE_IGNORE",
    ] {
        assert!(RULE.contains(id), "{id}");
    }
    assert!(RULE_NAME < "73-seat-late.rules");
}
