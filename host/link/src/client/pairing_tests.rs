//! Answers that are late, lost, doubled and out of order, in time that only waiting moves: none is taken for another's.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::messages::{AnyMessage, LinkTested, TestLink};
use proptest::prelude::*;

use super::super::fake::{front_end, hello};
use super::*;

/// Time-out of a request, and of each time that it is sent.
const WITHIN_MS: u64 = 600;
const TRY_MS: u64 = WITHIN_MS / MAX_SENDS as u64;

/// Milliseconds from the sending of a request until each copy of its answer arrives; none where it is lost.
type Fate = Vec<u64>;

/// A device that answers each request with what stands in it, as often and as late as its fate is.
struct Echo {
    now: Duration,
    deframer: Deframer,
    seq: u16,
    /// Those of the frames to come; at once where there is none.
    fates: Arc<Mutex<VecDeque<Fate>>>,
    on_the_way: Vec<(Duration, Vec<u8>)>,
}

impl Echo {
    fn answer(&mut self, message: &AnyMessage<'_>, number: Number) -> Option<Vec<u8>> {
        let mut frame = [0; MAX_ENCODED];
        let seq = self.seq;
        let length = match message {
            AnyMessage::Hello(_) => encode_numbered(&hello(), number, seq, &mut frame),
            AnyMessage::GetFrontEnd(_) => encode_numbered(&front_end(), number, seq, &mut frame),
            AnyMessage::SetPower(m) => {
                let detail = m.power_w.into();
                let outcome = match m.power_w % 2 {
                    0 => Outcome::Ok,
                    _ => Outcome::PowerOutOfRange,
                };
                encode_numbered(&Reply { outcome, detail }, number, seq, &mut frame)
            }
            AnyMessage::TestLink(m) => {
                let tested = LinkTested {
                    frames: m.frames.into(),
                    bytes: 0,
                    bad: 0,
                    lost: 0,
                };
                encode_numbered(&tested, number, seq, &mut frame)
            }
            _ => return None,
        };
        self.seq = seq.wrapping_add(1);
        Some(frame[..length.unwrap()].to_vec())
    }
}

impl Transport for Echo {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let ((number, payload), id) = (frame.split(), frame.id);
            let payload = payload.to_vec();
            let message = AnyMessage::decode(id, &payload).unwrap();
            let fate = self.fates.lock().unwrap().pop_front();
            let answer = self.answer(&message, number).unwrap();
            for delay_ms in fate.unwrap_or_else(|| vec![0]) {
                let at = self.now + Duration::from_millis(delay_ms);
                self.on_the_way.push((at, answer.clone()));
            }
        }
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        self.on_the_way.sort_by_key(|(at, _)| *at);
        let deadline = self.now + timeout;
        if self.on_the_way.first().is_none_or(|(at, _)| *at > deadline) {
            self.now = deadline;
            return Ok(0);
        }
        let (at, frame) = self.on_the_way.remove(0);
        self.now = self.now.max(at);
        buf[..frame.len()].copy_from_slice(&frame);
        Ok(frame.len())
    }

    fn describe(&self) -> String {
        "echo".into()
    }

    fn clock(&self) -> Duration {
        self.now
    }
}

/// Arrivals that never fall on the end of a time-out, from at once to long after the next requests.
fn fate() -> impl Strategy<Value = Fate> {
    prop::collection::vec((0..400u64).prop_map(|n| 5 * n + 1), 0..3)
}

/// Milliseconds until the first answer to one of the tries is there; none where all come too late.
fn first_ms(fates: &[Fate]) -> Option<u64> {
    let tries = fates.iter().zip(0u64..);
    let arrivals = tries.flat_map(|(fate, k)| fate.iter().map(move |ms| k * TRY_MS + ms));
    arrivals.min().filter(|ms| *ms < WITHIN_MS)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    /// Each request gets its own answer as soon as one is there, and none where there is none in time.
    #[test]
    fn an_answer_is_taken_for_no_other_requests(
        requests in prop::collection::vec((any::<bool>(), prop::collection::vec(fate(), MAX_SENDS as usize)), 1..30),
    ) {
        let fates = Arc::new(Mutex::new(VecDeque::new()));
        let echo = Echo {
            now: Duration::ZERO,
            deframer: Deframer::new(),
            seq: 0,
            fates: Arc::clone(&fates),
            on_the_way: Vec::new(),
        };
        let mut client = Client::connect(Box::new(echo)).unwrap();
        client.set_timeout(Duration::from_millis(WITHIN_MS));
        for (k, (is_power, fate)) in requests.iter().enumerate() {
            *fates.lock().unwrap() = fate.iter().cloned().collect();
            let (k, began) = (k as u16, client.clock());
            let told = if *is_power {
                match client.request(&SetPower { power_w: k }) {
                    Ok(Reply { detail, .. }) => (k % 2 == 0).then_some(detail),
                    Err(LinkError::Refused { detail, .. }) => (k % 2 == 1).then_some(detail),
                    Err(_) => None,
                }
            } else {
                client.request(&TestLink { frames: k, bytes: 0 }).ok().map(|m| m.frames)
            };
            let first = first_ms(fate);
            prop_assert_eq!(told, first.map(|_| u32::from(k)));
            let took = client.clock() - began;
            prop_assert_eq!(took, Duration::from_millis(first.unwrap_or(WITHIN_MS)));
        }
    }
}
