//! Following a board's log through lost cables, resets and new firmware, until stopped.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_link::LinkError;

use super::decoder::{Decoded, Decoder};
use super::find::{Places, TableLookupError};
use super::running::RunningProgram;
use crate::programmer::ProgramError;

/// Time limit of one read; Ctrl-C is noticed after it.
const READ_TIMEOUT: Duration = Duration::from_millis(100);

/// Pause between two attempts to reconnect.
const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// Error of reading a log.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// Error of the link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// Error of the debug probe, or of the chip behind it.
    #[error(transparent)]
    Probe(#[from] ProgramError),
    /// The board's program restarted.
    #[error("{device} was reset")]
    Reset {
        /// The device.
        device: String,
    },
}

impl LogError {
    /// Returns `true` if a cable, a power switch or a reset may be the cause, so that reconnecting is worth a try.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Reset { .. } => true,
            Self::Link(why) => why.may_pass(),
            Self::Probe(
                ProgramError::NotFound { .. }
                | ProgramError::Open { .. }
                | ProgramError::NoChip { .. }
                | ProgramError::Lost { .. }
                | ProgramError::Probe { .. },
            ) => true,
            Self::Probe(_) => false,
        }
    }
}

/// Data received since the last read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LogChunk {
    /// Messages lost before these bytes because the board had no room.
    pub lost_messages: u64,
    /// Bytes lost in transmission before these bytes.
    pub lost_bytes: u64,
    /// Bytes of the log.
    pub bytes: Vec<u8>,
}

/// Open log.
pub trait OpenLog {
    /// Device in words, printable.
    fn device(&self) -> String;

    /// Program that the device runs.
    fn running(&self) -> RunningProgram;

    /// Waits up to `wait` for data; returns an empty chunk if there is none.
    ///
    /// # Errors
    /// The reason why the log ended.
    fn read(&mut self, wait: Duration) -> Result<LogChunk, LogError>;

    /// Ends the log.
    fn close(&mut self) {}
}

/// Access to a log, which can be reopened.
pub trait LogOpener {
    /// Opens the log.
    ///
    /// # Errors
    /// The reason why it cannot be opened.
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError>;
}

/// Event of a followed log.
#[derive(Debug)]
pub enum LogEvent<'a> {
    /// A board is connected.
    Began {
        /// The device in words.
        device: &'a str,
        /// Program that it runs.
        running: &'a RunningProgram,
        /// Image whose table is used, or the reason why there is none.
        table: Result<&'a str, &'a TableLookupError>,
    },
    /// The board is back and runs the same program.
    Back {
        /// Duration of the interruption.
        away: Duration,
    },
    /// The board is disconnected.
    Away {
        /// Reason.
        why: &'a LogError,
    },
    /// Messages are missing before the next event.
    Lost {
        /// Messages for which the board had no room.
        messages: u64,
        /// Bytes lost in transmission.
        bytes: u64,
    },
    /// A decoded item.
    Decoded(Decoded),
}

/// Follows a log until `stop`.
///
/// # Errors
/// The error of the first opening, and every error that reconnecting does not cure: [`LogError`]; [`TableLookupError`] for a given image
/// that is not the one that runs; and the error of `report`.
pub fn follow<E: From<LogError> + From<TableLookupError>>(
    way: &mut dyn LogOpener,
    places: &Places<'_>,
    stop: &AtomicBool,
    mut report: impl FnMut(LogEvent<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let mut log = way.open()?;
    let mut before = log.running();
    let table = places.table(&before);
    if places.given.is_some() && table.is_err() {
        return table.map(drop).map_err(E::from);
    }
    let mut decoder = begin_decoding(log.as_ref(), table, &mut report)?;
    while !stop.load(Ordering::Relaxed) {
        let why = match log.read(READ_TIMEOUT) {
            Ok(chunk) => {
                report_chunk(&chunk, &mut decoder, &mut report)?;
                continue;
            }
            Err(why) if why.may_pass() => why,
            Err(why) => return Err(why.into()),
        };
        let since = Instant::now();
        report(LogEvent::Away { why: &why })?;
        // Closed before reopening: a probe and a serial port are exclusive.
        drop(log);
        let Some(again) = await_again(way, stop)? else {
            return Ok(());
        };
        log = again;
        let away = since.elapsed();
        report(LogEvent::Back { away })?;
        decoder.lost();
        let now = log.running();
        if now != before {
            decoder = begin_decoding(log.as_ref(), places.table(&now), &mut report)?;
            before = now;
        }
    }
    log.close();
    Ok(())
}

fn begin_decoding<E>(
    log: &dyn OpenLog,
    table: Result<super::table::LogTable, TableLookupError>,
    report: &mut impl FnMut(LogEvent<'_>) -> Result<(), E>,
) -> Result<Decoder, E> {
    report(LogEvent::Began {
        device: &log.device(),
        running: &log.running(),
        table: table.as_ref().map(|table| table.image()),
    })?;
    Ok(Decoder::new(table.ok()))
}

fn report_chunk<E>(
    chunk: &LogChunk,
    decoder: &mut Decoder,
    report: &mut impl FnMut(LogEvent<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let (messages, bytes) = (chunk.lost_messages, chunk.lost_bytes);
    if messages > 0 || bytes > 0 {
        decoder.lost();
        report(LogEvent::Lost { messages, bytes })?;
    }
    let mut result = Ok(());
    decoder.push(&chunk.bytes, |item| {
        if result.is_ok() {
            result = report(LogEvent::Decoded(item));
        }
    });
    result
}

fn await_again(
    way: &mut dyn LogOpener,
    stop: &AtomicBool,
) -> Result<Option<Box<dyn OpenLog>>, LogError> {
    loop {
        let until = Instant::now() + RETRY_PERIOD;
        while Instant::now() < until {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            sleep(READ_TIMEOUT.min(until.saturating_duration_since(Instant::now())));
        }
        match way.open() {
            Ok(log) => return Ok(Some(log)),
            Err(why) if why.may_pass() => {}
            Err(why) => return Err(why),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;
    use crate::image::BuildId;

    /// Next action of the scripted board.
    enum Act {
        Send(u64, Vec<u8>),
        Fail(LogError),
        Stop,
    }

    struct Script<'a> {
        opens: VecDeque<Result<(u8, VecDeque<Act>), LogError>>,
        stop: &'a AtomicBool,
    }

    struct Scripted {
        id: u8,
        acts: VecDeque<Act>,
        stop: &'static AtomicBool,
    }

    impl OpenLog for Scripted {
        fn device(&self) -> String {
            "scripted".into()
        }

        fn running(&self) -> RunningProgram {
            RunningProgram {
                build: "ihd-firmware 1".into(),
                build_id: Some(BuildId([self.id; 20])),
                crc: None,
            }
        }

        fn read(&mut self, _: Duration) -> Result<LogChunk, LogError> {
            match self.acts.pop_front() {
                Some(Act::Send(lost_messages, bytes)) => Ok(LogChunk {
                    lost_messages,
                    lost_bytes: 0,
                    bytes,
                }),
                Some(Act::Fail(why)) => Err(why),
                Some(Act::Stop) | None => {
                    self.stop.store(true, Ordering::Relaxed);
                    Ok(LogChunk::default())
                }
            }
        }
    }

    impl LogOpener for Script<'static> {
        fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError> {
            let (id, acts) = self.opens.pop_front().expect("the script goes on")?;
            let stop = self.stop;
            Ok(Box::new(Scripted { id, acts, stop }))
        }
    }

    #[derive(Debug)]
    struct Ended(String);

    impl From<LogError> for Ended {
        fn from(why: LogError) -> Self {
            Self(why.to_string())
        }
    }

    impl From<TableLookupError> for Ended {
        fn from(why: TableLookupError) -> Self {
            Self(why.to_string())
        }
    }

    fn closed() -> LogError {
        let device = "scripted".into();
        LogError::Link(LinkError::Closed { device })
    }

    fn run(opens: Vec<Result<(u8, Vec<Act>), LogError>>) -> (Result<(), Ended>, Vec<String>) {
        let stop: &'static AtomicBool = Box::leak(Box::default());
        let opens = opens
            .into_iter()
            .map(|open| open.map(|(id, acts)| (id, acts.into())));
        let mut script = Script {
            opens: opens.collect(),
            stop,
        };
        let mut told = Vec::new();
        let places = Places::default();
        let ended = follow(&mut script, &places, stop, |happening| {
            told.push(match happening {
                LogEvent::Began { running, table, .. } => {
                    format!("began {} {}", running.describe(), table.is_ok())
                }
                LogEvent::Back { .. } => "back".into(),
                LogEvent::Away { why } => format!("away {why}"),
                LogEvent::Lost { messages, .. } => format!("lost {messages}"),
                LogEvent::Decoded(item) => format!("{item:?}"),
            });
            Ok(())
        });
        (ended, told)
    }

    #[test]
    fn a_cable_that_comes_back_is_told_once_and_the_log_goes_on() {
        let (ended, told) = run(vec![
            Ok((1, vec![Act::Send(0, vec![5, 0, 6]), Act::Fail(closed())])),
            Err(closed()),
            Err(closed()),
            Ok((1, vec![Act::Send(0, vec![7, 0]), Act::Stop])),
        ]);
        ended.unwrap();
        let away = format!("away {}", closed());
        let began = "began ihd-firmware 1 (build 01010101) false";
        assert_eq!(told, [began, "Unread", &away, "back", "Unread"]);
    }

    #[test]
    fn another_firmware_after_the_reset_is_another_table() {
        let (ended, told) = run(vec![
            Ok((1, vec![Act::Fail(closed())])),
            Ok((2, vec![Act::Stop])),
        ]);
        ended.unwrap();
        let began = told.iter().filter(|line| line.starts_with("began"));
        assert_eq!(began.count(), 2, "{told:?}");
        assert!(told.last().unwrap().contains("02020202"), "{told:?}");
    }

    #[test]
    fn what_is_lost_is_told_before_what_comes_behind_it() {
        let (_, told) = run(vec![Ok((
            1,
            vec![Act::Send(0, vec![1]), Act::Send(3, vec![2, 0]), Act::Stop],
        ))]);
        assert_eq!(told[1..], ["lost 3", "Unread"]);
    }

    #[test]
    fn what_no_waiting_mends_ends_it() {
        let wrong = || LogError::Probe(ProgramError::WrongChip { id_code: 0x468 });
        let (ended, told) = run(vec![Err(wrong())]);
        assert!(ended.unwrap_err().0.contains("0x00000468") && told.is_empty());
        let (ended, _) = run(vec![Ok((1, vec![Act::Fail(closed())])), Err(wrong())]);
        assert!(ended.unwrap_err().0.contains("0x00000468"));
        // At first, nobody waits for a device that is not there.
        let (ended, _) = run(vec![Err(closed())]);
        assert!(ended.is_err());
    }
}
