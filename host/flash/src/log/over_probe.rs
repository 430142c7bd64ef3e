//! A board's log through a debug probe: RTT, without a reset and without a word to the board.

use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_shared::image::{HEADER_ADDRESS, HEADER_BYTES, Header, NOTE_ADDRESS, NOTE_BYTES, build_id};

use super::follow::{Chunk, LogError, OpenLog, Way};
use super::running::Running;
use crate::image::BuildId;
use crate::log_source::LogSource;
use crate::probe::{Probes, RttSource};
use crate::programmer::Programmer;

/// Between two looks into the board's ring: it holds more than comes meanwhile.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// How often it is looked whether the flash still holds the same image.
const ASK_EVERY: Duration = Duration::from_secs(2);

/// A board behind a probe.
pub struct ProbeWay {
    probes: Probes,
    selector: Option<String>,
}

impl ProbeWay {
    /// Through the probe with this selector, or the only one.
    pub fn new(probes: Probes, selector: Option<&str>) -> Self {
        Self {
            probes,
            selector: selector.map(str::to_owned),
        }
    }
}

impl Way for ProbeWay {
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
        let selector = self.selector.as_deref();
        let mut programmer = self.probes.attach(selector)?;
        programmer.identify()?;
        let running = running(&mut programmer)?;
        let note = note(|address, out| programmer.read(address, out))?;
        // One at a time holds a probe.
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

/// What the flash holds.
fn running(programmer: &mut dyn Programmer) -> Result<Running, LogError> {
    let note = note(|address, out| programmer.read(address, out))?;
    let mut header = [0; HEADER_BYTES];
    programmer.read(HEADER_ADDRESS, &mut header)?;
    let Some(header) = Header::parse(&header) else {
        return Ok(Running::default());
    };
    let mut crc = [0; 4];
    programmer.read(header.crc_address, &mut crc)?;
    Ok(Running {
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
    running: Running,
    /// The note that was there when it was opened.
    note: [u8; NOTE_BYTES],
    asked: Instant,
}

impl OpenLog for ProbeLog {
    fn device(&self) -> String {
        ihd_signal::printable(&self.source.describe()).to_string()
    }

    fn running(&self) -> Running {
        self.running.clone()
    }

    fn read(&mut self, wait: Duration) -> Result<Chunk, LogError> {
        let until = Instant::now() + wait;
        let mut chunk = Chunk::default();
        while self.source.read(&mut chunk.bytes)? == 0 && Instant::now() < until {
            sleep(LOOK_EVERY.min(until.saturating_duration_since(Instant::now())));
        }
        if self.asked.elapsed() >= ASK_EVERY {
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
