//! Server-Sent Events as an iterator.

use std::io::{self, BufRead, BufReader, Read};

use ihd_daemon::model::Notice;
use serde::Deserialize as _;

use crate::model::Missed;

/// Longest line, in bytes; no notice is near.
const MAX_LINE: u64 = 1 << 20;

/// What a watcher gets.
#[derive(Clone, Debug, PartialEq)]
pub enum Watched {
    /// Something happened.
    Notice(Box<Notice>),
    /// So many notices were dropped, for this reader was too slow.
    Missed(u64),
    /// Nothing happened for a while, and the daemon is there.
    Heartbeat,
    /// Something that this version does not know, as JSON: a newer daemon's.
    Unknown(String),
}

/// Events until the daemon ends or the link is cut; the last item says which.
pub struct Events {
    lines: BufReader<Box<dyn Read + Send>>,
    ended: bool,
}

impl Events {
    pub(super) fn new(reader: impl Read + Send + 'static) -> Self {
        Self {
            lines: BufReader::new(Box::new(reader)),
            ended: false,
        }
    }

    /// The next event; `None` when the stream ended in order.
    fn read(&mut self) -> io::Result<Option<Watched>> {
        let (mut kind, mut data, mut comment) = (String::new(), String::new(), false);
        loop {
            let mut line = String::new();
            let bytes = (&mut self.lines).take(MAX_LINE).read_line(&mut line)?;
            if bytes == 0 {
                return Ok(None);
            }
            if bytes as u64 == MAX_LINE {
                return Err(io::Error::other("a line of the events is too long"));
            }
            let line = line.trim_end_matches(['\n', '\r']);
            if line.is_empty() {
                if !data.is_empty() {
                    return event(&kind, &data).map(Some);
                }
                if comment {
                    return Ok(Some(Watched::Heartbeat));
                }
                continue;
            }
            let (field, value) = line.split_once(':').unwrap_or((line, ""));
            let value = value.strip_prefix(' ').unwrap_or(value);
            match field {
                "" => comment = true,
                "event" => kind = value.into(),
                "data" => data += value,
                _ => {}
            }
        }
    }
}

fn event(kind: &str, data: &str) -> io::Result<Watched> {
    let strange = |e: serde_json::Error| io::Error::new(io::ErrorKind::InvalidData, e);
    match kind {
        "missed" => {
            let missed: Missed = serde_json::from_str(data).map_err(strange)?;
            Ok(Watched::Missed(missed.missed))
        }
        _ => {
            // As a value first: defmt's decoder switches serde_json's arbitrary_precision on, with which no float is found in
            // what is flattened or tagged, unless it comes from a value.
            let value: serde_json::Value = serde_json::from_str(data).map_err(strange)?;
            Ok(match Notice::deserialize(&value) {
                Ok(notice) => Watched::Notice(Box::new(notice)),
                Err(_) => Watched::Unknown(value.to_string()),
            })
        }
    }
}

impl Iterator for Events {
    type Item = io::Result<Watched>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let item = self.read().transpose();
        self.ended = !matches!(item, Some(Ok(_)));
        item
    }
}

#[cfg(test)]
mod tests {
    use ihd_daemon::model::What;

    use super::*;

    #[test]
    fn events_are_read_as_the_standard_says() {
        let text = ": watching\n\n\
            data: {\"at_ms\":1,\"device\":\"a\",\"event\":\"fault\",\"fault\":0,\"text\":\"\"}\n\n\
            event: missed\r\ndata: {\"missed\":3}\r\n\r\n\
            :\n\n";
        let seen: Vec<Watched> = Events::new(text.as_bytes()).map(Result::unwrap).collect();
        let notice = Notice {
            at_ms: 1,
            device: "a".into(),
            what: What::Fault {
                fault: 0,
                text: String::new(),
            },
        };
        assert_eq!(
            seen,
            [
                Watched::Heartbeat,
                Watched::Notice(Box::new(notice)),
                Watched::Missed(3),
                Watched::Heartbeat
            ]
        );
    }

    /// Whatever features of serde_json another crate of the build has switched on.
    #[test]
    fn floats_of_what_is_flattened_are_found() {
        let live = ihd_daemon::model::Live {
            half_cycle: 7,
            state: "Heating".into(),
            pot: "Ferromagnetic".into(),
            fault: 0,
            fault_text: String::new(),
            limit: "None".into(),
            asked_w: 1_200,
            power_w: 1_203.5,
            f_sw_hz: 51_020,
            i_crest_a: 44.75,
            r_ohm: 3.274,
            l_h: 19.1e-6,
        };
        let notice = Notice {
            at_ms: 1,
            device: "a".into(),
            what: What::Telemetry { live },
        };
        let text = format!("data: {}\n\n", serde_json::to_string(&notice).unwrap());
        let mut events = Events::new(io::Cursor::new(text));
        let seen = events.next().unwrap().unwrap();
        assert_eq!(seen, Watched::Notice(Box::new(notice)));
    }

    #[test]
    fn nonsense_ends_the_events_with_an_error_and_news_do_not() {
        let text = "data: {\"event\":\"explosion\"}\n\ndata: {\n\ndata: {}\n\n";
        let mut events = Events::new(text.as_bytes());
        assert!(matches!(events.next(), Some(Ok(Watched::Unknown(_)))));
        assert!(events.next().unwrap().is_err());
        assert!(events.next().is_none());
    }
}
