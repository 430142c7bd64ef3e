//! Log of a board through a debug probe: RTT, without a reset and without messages to the board.

use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_shared::image::{HEADER_ADDRESS, HEADER_BYTES, Header, NOTE_ADDRESS, NOTE_BYTES, build_id};

use super::follow::{LogChunk, LogError, LogOpener, OpenLog};
use super::running::RunningProgram;
use crate::image::BuildId;
use crate::probe::{Probes, RttSource};
use crate::programmer::Programmer;

/// Period of reading the board's ring, which holds more than comes in that time.
const POLL_PERIOD: Duration = Duration::from_millis(20);

/// Period of checking that the flash still holds the same image.
const IMAGE_CHECK_PERIOD: Duration = Duration::from_secs(2);

/// Board behind a probe.
pub struct ProbeLogOpener {
    probes: Probes,
    selector: Option<String>,
}

impl ProbeLogOpener {
    /// Creates one for the probe with this selector, or the only one.
    pub fn new(probes: Probes, selector: Option<&str>) -> Self {
        Self {
            probes,
            selector: selector.map(str::to_owned),
        }
    }
}

impl LogOpener for ProbeLogOpener {
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
        let selector = self.selector.as_deref();
        let mut programmer = self.probes.attach(selector)?;
        programmer.identify()?;
        let running = running(&mut programmer)?;
        let note = note(|address, out| programmer.read(address, out))?;
        // A probe is exclusive.
        drop(programmer);
        let mut source = self.probes.log(selector, None)?;
        source.resume()?;
        Ok(Box::new(ProbeLog {
            source,
            running,
            note,
            asked: Instant::now(),
        }))
    }
}

/// Reads which program the flash holds.
fn running(programmer: &mut dyn Programmer) -> Result<RunningProgram, LogError> {
    let note = note(|address, out| programmer.read(address, out))?;
    let mut header = [0; HEADER_BYTES];
    programmer.read(HEADER_ADDRESS, &mut header)?;
    let Some(header) = Header::parse(&header) else {
        return Ok(RunningProgram::default());
    };
    let mut crc = [0; 4];
    programmer.read(header.crc_address, &mut crc)?;
    Ok(RunningProgram {
        build: ihd_signal::printable(&format!("ihd-firmware {}", header.version())).to_string(),
        build_id: build_id(&note).map(BuildId),
        crc: Some(u32::from_le_bytes(crc)),
    })
}

fn note<E>(mut read: impl FnMut(u32, &mut [u8]) -> Result<(), E>) -> Result<[u8; NOTE_BYTES], E> {
    let mut note = [0; NOTE_BYTES];
    read(NOTE_ADDRESS, &mut note)?;
    Ok(note)
}

struct ProbeLog {
    source: RttSource,
    running: RunningProgram,
    /// Note in flash when the log was opened.
    note: [u8; NOTE_BYTES],
    asked: Instant,
}

impl OpenLog for ProbeLog {
    fn device(&self) -> String {
        ihd_signal::printable(&self.source.describe()).to_string()
    }

    fn running(&self) -> RunningProgram {
        self.running.clone()
    }

    fn read(&mut self, wait: Duration) -> Result<LogChunk, LogError> {
        let until = Instant::now() + wait;
        let mut chunk = LogChunk::default();
        while self.source.read(&mut chunk.bytes)? == 0 && Instant::now() < until {
            sleep(POLL_PERIOD.min(until.saturating_duration_since(Instant::now())));
        }
        if self.asked.elapsed() >= IMAGE_CHECK_PERIOD {
            self.asked = Instant::now();
            let source = &mut self.source;
            if note(|address, out| source.memory(address, out))? != self.note {
                return Err(LogError::Reset {
                    device: self.device(),
                });
            }
        }
        Ok(chunk)
    }
}
