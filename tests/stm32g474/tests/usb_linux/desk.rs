//! Guest, boards beside it, and the USB/IP server between them.

use std::net::SocketAddr;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{bail, ensure};
use ihd_stm32g474::machine::Machine;
use ihd_stm32g474::usb::Cable;
use ihd_stm32g474::usb::usbip::Server;

use crate::boards::Board;
use crate::guest::Guest;

/// Longest time from plugging a board in until the kernel has its serial number.
const ENUMERATION: Duration = Duration::from_secs(60);
/// Time between two polls.
const GLANCE: Duration = Duration::from_millis(100);

/// Guest with boards that can be plugged into it.
pub struct Desk {
    /// Guest computer.
    pub guest: Guest,
    /// Boards that can be plugged into it.
    pub boards: Vec<Board>,
    server: SocketAddr,
}

/// Number in a JSON report by its name; the first if there are several.
pub fn number(report: &str, name: &str) -> f64 {
    let value = report
        .split_once(&format!("\"{name}\": "))
        .map(|(_, rest)| rest);
    let digits = value.and_then(|value| value.split([',', '\n', '}']).next());
    digits
        .and_then(|digits| digits.trim().parse().ok())
        .unwrap_or(f64::NAN)
}

impl Desk {
    /// Boots the guest with no board plugged in.
    pub fn new(boards: Vec<Board>) -> anyhow::Result<Self> {
        let desk = Self::with_cables(boards.iter().map(|board| board.cable.clone()))?;
        Ok(Self { boards, ..desk })
    }

    /// Boots the guest with cables that have other devices than boards at their ends.
    pub fn with_cables(cables: impl IntoIterator<Item = Cable>) -> anyhow::Result<Self> {
        let server = Server::start(cables)?.address();
        let began = Instant::now();
        let guest = Guest::boot()?;
        println!(
            "the guest is up after {:.1} s",
            began.elapsed().as_secs_f64()
        );
        Ok(Self {
            guest,
            boards: Vec::new(),
            server,
        })
    }

    /// Shell command that plugs a board in.
    pub fn attach(&self, board: usize) -> String {
        let (port, bus_id) = (self.server.port(), board + 1);
        format!("vhci-attach 10.0.2.2:{port} 1-{bus_id} {board}")
    }

    /// Plugs a board in and returns the serial number that the kernel reads.
    pub fn plug(&mut self, board: usize) -> anyhow::Result<String> {
        let began = Instant::now();
        let bus_id = format!("1-{}", board + 1);
        // The port of the virtual controller is free a moment after an unplugging.
        let attach = self.attach(board);
        self.until(&attach, ENUMERATION)?;
        let serial = format!("cat /sys/bus/usb/devices/{bus_id}/serial");
        self.until(&format!("{serial} 2>/dev/null"), ENUMERATION)?;
        println!("plugged in after {:.1} s", began.elapsed().as_secs_f64());
        Ok(self.guest.shell(&serial)?.trim().to_owned())
    }

    /// Repeats a line of shell until it succeeds.
    pub fn until(&mut self, line: &str, timeout: Duration) -> anyhow::Result<()> {
        let deadline = Instant::now() + timeout;
        loop {
            let answer = self.guest.run(line, timeout)?;
            if answer.status == 0 {
                return Ok(());
            }
            if Instant::now() > deadline {
                let log = self.guest.shell("dmesg | tail -20")?;
                bail!("not within {timeout:?}: {line}: {}\n{log}", answer.text);
            }
            thread::sleep(GLANCE);
        }
    }

    /// Runs `ihd record` into a file of the guest; returns its report in JSON.
    pub fn record(
        &mut self,
        file: &str,
        options: &str,
        timeout: Duration,
    ) -> anyhow::Result<String> {
        let emulated = |desk: &Self| desk.boards[0].bench.now_s();
        let (began, from) = (Instant::now(), emulated(self));
        let line = format!(
            "ihd record --device usb --out {file} {options} --json 2>record.log || cat record.log"
        );
        let answer = self.guest.run(&line, timeout)?;
        let report = answer.text;
        ensure!(report.contains("\"link\""), "{line}: {report}");
        let (wall, passed) = (began.elapsed().as_secs_f64(), emulated(self) - from);
        // The numbers of the file come before those of the link.
        let link = report.split_once("\"link\"").map_or("", |(_, link)| link);
        let (bytes, windows) = (number(link, "bytes"), number(link, "windows"));
        println!(
            "recorded {windows} windows, {bytes} bytes, in {wall:.1} s; {passed:.2} s on the chip"
        );
        Ok(report)
    }

    /// Asserts at the end that no board violated its manual or was reset.
    pub fn end(self) {
        for board in &self.boards {
            let ended = |machine: &mut Machine| (machine.violations(), machine.resets.clone());
            let (violations, resets) = board.bench.with(ended);
            let violations: Vec<_> = violations.iter().map(ToString::to_string).collect();
            assert!(violations.is_empty(), "{violations:#?}");
            assert!(resets.is_empty(), "{resets:?}");
        }
    }
}
