//! Follows a board's log for as long as somebody listens: through lost cables, resets and new firmware.

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use ihd_link::LinkError;
use ihd_shared::wire::messages::Outcome;

use super::decoder::{Decoder, Found};
use super::find::{NoTable, Places};
use super::running::Running;
use crate::programmer::ProgramError;

/// How long one look for bytes may take: ^C is seen after it.
const LOOK: Duration = Duration::from_millis(100);

/// Between two tries to come back.
const TRY_EVERY: Duration = Duration::from_millis(500);

/// Why a log is not to be had.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The debug probe, or the chip behind it.
    #[error(transparent)]
    Probe(#[from] ProgramError),
    /// The board's program began anew.
    #[error("{device} was reset")]
    Reset {
        /// The device.
        device: String,
    },
}

impl LogError {
    /// Whether a cable, a power switch or a reset may be behind it, so that it is worth waiting.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Reset { .. } => true,
            Self::Link(
                LinkError::Connect { .. }
                | LinkError::Closed { .. }
                | LinkError::Io { .. }
                | LinkError::NoAnswer { .. },
            ) => true,
            // A device that was reset has forgotten that we said hello.
            Self::Link(LinkError::Refused { outcome, .. }) => *outcome == Outcome::NotPaired,
            Self::Link(_) => false,
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

/// What came since the last look.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Chunk {
    /// Messages that the board had no room for, before these bytes.
    pub lost_messages: u64,
    /// Bytes of log that were lost on the way, before these bytes.
    pub lost_bytes: u64,
    /// Bytes of the log.
    pub bytes: Vec<u8>,
}

/// A log that is open.
pub trait OpenLog {
    /// The device in words, fit to be shown.
    fn device(&self) -> String;

    /// What runs there.
    fn running(&self) -> Running;

    /// Waits up to `wait` for something to come; an empty chunk where nothing did.
    ///
    /// # Errors
    /// Whatever ended it.
    fn read(&mut self, wait: Duration) -> Result<Chunk, LogError>;

    /// Nobody listens any more.
    fn close(&mut self) {}
}

/// A way to a log, which may be opened again after its end.
pub trait Way {
    /// Opens it.
    ///
    /// # Errors
    /// What is in the way.
    fn open(&mut self) -> Result<Box<dyn OpenLog>, LogError>;
}

/// What happens to somebody who listens.
#[derive(Debug)]
pub enum Happening<'a> {
    /// A board is there.
    Began {
        /// The device in words.
        device: &'a str,
        /// What it runs.
        running: &'a Running,
        /// The image whose texts are used.
        table: Result<&'a str, &'a NoTable>,
    },
    /// It is back, with what it ran before.
    Back {
        /// So long was it away.
        away: Duration,
    },
    /// It is gone.
    Away {
        /// Why.
        why: &'a LogError,
    },
    /// Something is missing before what comes next.
    Lost {
        /// Messages that the board had no room for.
        messages: u64,
        /// Bytes that were lost on the way.
        bytes: u64,
    },
    /// Something came.
    Found(Found),
}

/// Follows a log until `stop`.
///
/// # Errors
/// What keeps it from being opened at first, and what no waiting mends: [`LogError`], [`NoTable`] for an image that was
/// given and is not what runs; and what `tell` returns.
pub fn follow<E: From<LogError> + From<NoTable>>(
    way: &mut dyn Way,
    places: &Places<'_>,
    stop: &AtomicBool,
    mut tell: impl FnMut(Happening<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let mut log = way.open()?;
    let mut before = log.running();
    let table = places.table(&before);
    if places.given.is_some() && table.is_err() {
        return table.map(drop).map_err(E::from);
    }
    let mut decoder = began(log.as_ref(), table, &mut tell)?;
    while !stop.load(Ordering::Relaxed) {
        let why = match log.read(LOOK) {
            Ok(chunk) => {
                take(&chunk, &mut decoder, &mut tell)?;
                continue;
            }
            Err(why) if why.may_pass() => why,
            Err(why) => return Err(why.into()),
        };
        let since = Instant::now();
        tell(Happening::Away { why: &why })?;
        // Before it is opened anew: a probe and a serial port are held by one alone.
        drop(log);
        let Some(again) = await_again(way, stop)? else {
            return Ok(());
        };
        log = again;
        let away = since.elapsed();
        tell(Happening::Back { away })?;
        decoder.lost();
        let now = log.running();
        if now != before {
            decoder = began(log.as_ref(), places.table(&now), &mut tell)?;
            before = now;
        }
    }
    log.close();
    Ok(())
}

fn began<E>(
    log: &dyn OpenLog,
    table: Result<super::table::Table, NoTable>,
    tell: &mut impl FnMut(Happening<'_>) -> Result<(), E>,
) -> Result<Decoder, E> {
    tell(Happening::Began {
        device: &log.device(),
        running: &log.running(),
        table: table.as_ref().map(|table| table.image()),
    })?;
    Ok(Decoder::new(table.ok()))
}

fn take<E>(
    chunk: &Chunk,
    decoder: &mut Decoder,
    tell: &mut impl FnMut(Happening<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let (messages, bytes) = (chunk.lost_messages, chunk.lost_bytes);
    if messages > 0 || bytes > 0 {
        decoder.lost();
        tell(Happening::Lost { messages, bytes })?;
    }
    let mut told = Ok(());
    decoder.push(&chunk.bytes, |found| {
        if told.is_ok() {
            told = tell(Happening::Found(found));
        }
    });
    told
}

fn await_again(way: &mut dyn Way, stop: &AtomicBool) -> Result<Option<Box<dyn OpenLog>>, LogError> {
    loop {
        let until = Instant::now() + TRY_EVERY;
        while Instant::now() < until {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            sleep(LOOK.min(until.saturating_duration_since(Instant::now())));
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

    /// What the scripted board does next.
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

        fn running(&self) -> Running {
            Running {
                build: "ihd-firmware 1".into(),
                build_id: Some(BuildId([self.id; 20])),
                crc: None,
            }
        }

        fn read(&mut self, _: Duration) -> Result<Chunk, LogError> {
            match self.acts.pop_front() {
                Some(Act::Send(lost_messages, bytes)) => Ok(Chunk {
                    lost_messages,
                    lost_bytes: 0,
                    bytes,
                }),
                Some(Act::Fail(why)) => Err(why),
                Some(Act::Stop) | None => {
                    self.stop.store(true, Ordering::Relaxed);
                    Ok(Chunk::default())
                }
            }
        }
    }

    impl Way for Script<'static> {
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

    impl From<NoTable> for Ended {
        fn from(why: NoTable) -> Self {
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
                Happening::Began { running, table, .. } => {
                    format!("began {} {}", running.describe(), table.is_ok())
                }
                Happening::Back { .. } => "back".into(),
                Happening::Away { why } => format!("away {why}"),
                Happening::Lost { messages, .. } => format!("lost {messages}"),
                Happening::Found(found) => format!("{found:?}"),
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
        let wrong = || LogError::Probe(ProgramError::WrongChip { found: 0x468 });
        let (ended, told) = run(vec![Err(wrong())]);
        assert!(ended.unwrap_err().0.contains("0x00000468") && told.is_empty());
        let (ended, _) = run(vec![Ok((1, vec![Act::Fail(closed())])), Err(wrong())]);
        assert!(ended.unwrap_err().0.contains("0x00000468"));
        // At first, nobody waits for a device that is not there.
        let (ended, _) = run(vec![Err(closed())]);
        assert!(ended.is_err());
    }
}
