//! A board that answers what belongs to a log.

use ihd_shared::wire::deframer::Deframer;
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{
    AnyMessage, Board, FrontEnd, Log, Message, Outcome, Raw, Reply, StreamLog,
};
use ihd_shared::wire::number::Number;

/// Bytes of log before these, dropped messages, bytes.
pub type Logged = (u32, u32, Vec<u8>);

/// The board: bytes of a host in, its frames out.
pub struct LogBoard {
    deframer: Deframer,
    build_id: u8,
    logs: Vec<Logged>,
    /// Frames sent so far.
    frames: u16,
    /// `true` once it was asked for its log.
    pub has_logged: bool,
}

impl LogBoard {
    /// Creates a board whose build id repeats a byte, and that logs this when asked.
    pub fn new(build_id: u8, logs: Vec<Logged>) -> Self {
        Self {
            deframer: Deframer::new(),
            build_id,
            logs,
            frames: 0,
            has_logged: false,
        }
    }

    /// Takes a byte; returns the answers to the message that it completes, as frames.
    pub fn receive(&mut self, byte: u8) -> Vec<u8> {
        let Some(Ok(frame)) = self.deframer.push(byte) else {
            return Vec::new();
        };
        let (number, payload) = frame.split();
        let Ok(message) = AnyMessage::decode(frame.id, payload) else {
            return Vec::new();
        };
        self.has_logged |= matches!(message, AnyMessage::StreamLog(_));
        let mut frames = Frames {
            number,
            sent: &mut self.frames,
            bytes: Vec::new(),
        };
        answer(&message, self.build_id, &self.logs, &mut frames);
        frames.bytes
    }
}

/// Frames that answer a request.
struct Frames<'a> {
    number: Number,
    sent: &'a mut u16,
    bytes: Vec<u8>,
}

impl Frames<'_> {
    fn push<M: Message>(&mut self, message: &M) {
        let mut frame = [0; MAX_ENCODED];
        let length = encode_numbered(message, self.number, *self.sent, &mut frame);
        self.bytes.extend(&frame[..length.expect("it fits")]);
        *self.sent = self.sent.wrapping_add(1);
    }
}

fn answer(message: &AnyMessage<'_>, build_id: u8, logs: &[Logged], frames: &mut Frames<'_>) {
    match message {
        AnyMessage::Hello(_) => {
            frames.push(&ours(ROLE_DEVICE, 0, 7, "ihd-firmware 9.8.7", "fake"));
        }
        AnyMessage::GetFrontEnd(_) => frames.push(&FrontEnd {
            v_full_scale_mv: 1_000_000,
            i_full_scale_ma: 100_000,
            bus_full_scale_mv: 500_000,
            mains_full_scale_mv: 500_000,
            bits: 12,
        }),
        AnyMessage::GetBoard(_) => frames.push(&Board {
            id_code: 0x2036_8469,
            flash_kib: 512,
            option_bytes: 0,
            reset_flags: 0,
            starts: 1,
            image_bytes: 100,
            image_crc: 1,
            sealed_crc: 2,
            build_id: Raw(&[build_id; 20]),
            chip: Raw(&[]),
        }),
        AnyMessage::StreamLog(StreamLog { on }) => {
            frames.push(&Reply {
                outcome: Outcome::Ok,
                detail: 0,
            });
            for (seq, dropped, data) in logs.iter().filter(|_| *on) {
                let (seq, dropped, data) = (*seq, *dropped, Raw(data));
                frames.push(&Log { seq, dropped, data });
            }
        }
        _ => {}
    }
}
