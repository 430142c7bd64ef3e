//! The log over a link, from a scripted device.

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{
    AnyMessage, Board, FrontEnd, Log, Message, Outcome, Raw, Reply, StreamLog,
};
use ihd_shared::wire::number::Number;

use super::*;

/// Bytes of log before these, dropped frames, bytes.
type Logged = (u32, u32, &'static [u8]);

/// A device that answers what belongs to a log, and nothing else. Its clock goes on with what is waited for.
struct Device {
    deframer: Deframer,
    bytes: Vec<u8>,
    sent: Sent,
    time: Duration,
    logs: &'static [Logged],
}

impl Device {
    fn boxed(logs: &'static [Logged]) -> Box<dyn Transport> {
        Box::new(Self {
            deframer: Deframer::new(),
            bytes: Vec::new(),
            sent: Sent {
                number: Number::NONE,
                frames: 0,
            },
            time: Duration::ZERO,
            logs,
        })
    }
}

/// Number of the request that is answered, and frames sent so far.
struct Sent {
    number: Number,
    frames: u16,
}

fn framed<M: Message>(message: &M, sent: &mut Sent) -> Vec<u8> {
    let mut frame = [0; MAX_ENCODED];
    let length = encode_numbered(message, sent.number, sent.frames, &mut frame).unwrap();
    sent.frames = sent.frames.wrapping_add(1);
    frame[..length].to_vec()
}

/// The answers to a message, as frames.
fn answers(message: &AnyMessage<'_>, logs: &[Logged], sent: &mut Sent) -> Vec<u8> {
    match message {
        AnyMessage::Hello(_) => framed(&ours(ROLE_DEVICE, 0, 7, "fake 1.0", "fake"), sent),
        AnyMessage::GetFrontEnd(_) => {
            let front_end = FrontEnd {
                v_full_scale_mv: 1_000_000,
                i_full_scale_ma: 100_000,
                bus_full_scale_mv: 500_000,
                mains_full_scale_mv: 500_000,
                bits: 12,
            };
            framed(&front_end, sent)
        }
        AnyMessage::GetBoard(_) => framed(
            &Board {
                id_code: 0x2036_8469,
                flash_kib: 512,
                option_bytes: 0,
                reset_flags: 0,
                starts: 1,
                image_bytes: 100,
                image_crc: 1,
                sealed_crc: 2,
                build_id: Raw(&[7; 20]),
                chip: Raw(&[]),
            },
            sent,
        ),
        AnyMessage::StreamLog(StreamLog { on }) => {
            let reply = Reply {
                outcome: Outcome::Ok,
                detail: 0,
            };
            let mut bytes = framed(&reply, sent);
            for &(seq, dropped, data) in logs.iter().filter(|_| *on) {
                let data = Raw(data);
                bytes.extend(framed(&Log { seq, dropped, data }, sent));
            }
            bytes
        }
        _ => Vec::new(),
    }
}

impl Transport for Device {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            let Some(Ok(frame)) = self.deframer.push(byte) else {
                continue;
            };
            let (number, payload) = frame.split();
            self.sent.number = number;
            if let Ok(message) = AnyMessage::decode(frame.id, payload) {
                self.bytes
                    .extend(answers(&message, self.logs, &mut self.sent));
            }
        }
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let n = self.bytes.len().min(buf.len());
        buf[..n].copy_from_slice(&self.bytes[..n]);
        self.bytes.drain(..n);
        if n == 0 {
            self.time += timeout;
        }
        Ok(n)
    }

    fn describe(&self) -> String {
        "fake".into()
    }

    fn clock(&self) -> Duration {
        self.time
    }
}

fn read(log: &mut dyn OpenLog) -> (u64, u64, Vec<u8>) {
    let chunk = log.read(Duration::from_millis(10)).unwrap();
    (chunk.lost_messages, chunk.lost_bytes, chunk.bytes)
}

#[test]
fn what_runs_is_asked_for_and_what_is_missing_is_counted_once() {
    const FIRST: &[Logged] = &[(70, 2, &[1, 0]), (72, 2, &[2, 0]), (80, 5, &[3, 0])];
    const AGAIN: &[Logged] = &[(90, 6, &[4, 0])];
    let mut devices = [FIRST, AGAIN].into_iter();
    let mut way = LinkLogOpener::new(|| Ok(Device::boxed(devices.next().unwrap())));
    let mut log = way.open().unwrap();
    let running = log.running();
    assert_eq!(running.build_id, Some(BuildId([7; 20])));
    assert_eq!((running.crc, running.build.as_str()), (Some(2), "fake 1.0"));
    assert_eq!(read(log.as_mut()), (2, 0, vec![1, 0]));
    assert_eq!(read(log.as_mut()), (0, 0, vec![2, 0]));
    assert_eq!(read(log.as_mut()), (3, 6, vec![3, 0]));
    assert_eq!(read(log.as_mut()), (0, 0, vec![]));
    log.close();
    // The same boot: what was told is not told again.
    let mut log = way.open().unwrap();
    assert_eq!(read(log.as_mut()), (1, 0, vec![4, 0]));
}

#[test]
fn a_device_that_says_nothing_is_asked_and_is_gone_then() {
    let mut way = LinkLogOpener::new(|| Ok(Device::boxed(&[])));
    let mut log = way.open().unwrap();
    let mut waited = Duration::ZERO;
    let why = loop {
        match log.read(Duration::from_millis(500)) {
            Ok(chunk) => assert_eq!(chunk, LogChunk::default()),
            Err(why) => break why,
        }
        waited += Duration::from_millis(500);
    };
    assert!(why.may_pass(), "{why}");
    assert!(why.to_string().contains("GetStatus"), "{why}");
    let asked = KEEPALIVE_PERIOD..KEEPALIVE_PERIOD + Duration::from_secs(1);
    assert!(asked.contains(&waited), "{waited:?}");
}
