//! Server-Sent Events as an iterator.

use std::io::{self, BufRead, BufReader, Read};

use ihd_model::{DaemonEvent, MissedEvents};
use serde::Deserialize as _;

/// Maximum length of a line, in bytes; far above that of any event.
const MAX_LINE: u64 = 1 << 20;

/// Item of an event stream.
#[derive(Clone, Debug, PartialEq)]
pub enum StreamItem {
    /// Event of the daemon.
    Event(Box<DaemonEvent>),
    /// Number of events that were dropped because this client reads too slowly.
    Missed(u64),
    /// Comment without an event: the connection is alive.
    Heartbeat,
    /// Event of a newer daemon that this version does not know, as JSON.
    Unknown(String),
}

/// Events until the stream ends; the last item is an error if the connection was lost.
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

    /// Reads the next item; `None` at the regular end of the stream.
    fn read(&mut self) -> io::Result<Option<StreamItem>> {
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
                    return Ok(Some(StreamItem::Heartbeat));
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

fn event(kind: &str, data: &str) -> io::Result<StreamItem> {
    let invalid = |e: serde_json::Error| io::Error::new(io::ErrorKind::InvalidData, e);
    match kind {
        "missed" => {
            let missed: MissedEvents = serde_json::from_str(data).map_err(invalid)?;
            Ok(StreamItem::Missed(missed.missed))
        }
        _ => {
            // Parsed to a value first: defmt's decoder enables the feature arbitrary_precision of serde_json, with which floats in
            // flattened or tagged types can be deserialised from a value only.
            let value: serde_json::Value = serde_json::from_str(data).map_err(invalid)?;
            Ok(match DaemonEvent::deserialize(&value) {
                Ok(event) => StreamItem::Event(Box::new(event)),
                Err(_) => StreamItem::Unknown(value.to_string()),
            })
        }
    }
}

impl Iterator for Events {
    type Item = io::Result<StreamItem>;

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
    use ihd_model::EventKind;

    use super::*;

    #[test]
    fn events_are_read_as_the_standard_says() {
        let text = ": watching\n\n\
            data: {\"at_ms\":1,\"device\":\"a\",\"event\":\"fault\",\"fault\":0,\"text\":\"\"}\n\n\
            event: missed\r\ndata: {\"missed\":3}\r\n\r\n\
            :\n\n";
        let seen: Vec<StreamItem> = Events::new(text.as_bytes()).map(Result::unwrap).collect();
        let notice = DaemonEvent {
            at_ms: 1,
            device: "a".into(),
            kind: EventKind::Fault {
                fault: 0,
                text: String::new(),
            },
        };
        assert_eq!(
            seen,
            [
                StreamItem::Heartbeat,
                StreamItem::Event(Box::new(notice)),
                StreamItem::Missed(3),
                StreamItem::Heartbeat
            ]
        );
    }

    /// With any features of serde_json that another crate of the build has enabled.
    #[test]
    fn floats_of_what_is_flattened_are_found() {
        let live = ihd_model::Live {
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
            glass_hot: true,
        };
        let notice = DaemonEvent {
            at_ms: 1,
            device: "a".into(),
            kind: EventKind::Telemetry { live },
        };
        let text = format!("data: {}\n\n", serde_json::to_string(&notice).unwrap());
        let mut events = Events::new(io::Cursor::new(text));
        let seen = events.next().unwrap().unwrap();
        assert_eq!(seen, StreamItem::Event(Box::new(notice)));
    }

    #[test]
    fn nonsense_ends_the_events_with_an_error_and_news_do_not() {
        let text = "data: {\"event\":\"explosion\"}\n\ndata: {\n\ndata: {}\n\n";
        let mut events = Events::new(text.as_bytes());
        assert!(matches!(events.next(), Some(Ok(StreamItem::Unknown(_)))));
        assert!(events.next().unwrap().is_err());
        assert!(events.next().is_none());
    }
}
