//! A bad cable: TCP in between that flips bits, loses, repeats and swaps frames, loses bytes, stalls and cuts,
//! each as often as asked and counted.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use crate::chance::Chance;

/// Period in which a waiting thread checks for its end.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// A run of bytes longer than this is no frame, and passed on as it is.
const MAX_FRAME_BYTES: usize = 4 * 1024;

/// Faults of the link, in either direction.
#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    pub seed: u64,
    /// Probability that a bit is flipped.
    pub flip: f64,
    /// Probability that a byte is lost.
    pub lose_byte: f64,
    /// Probability that a frame is lost.
    pub lose_frame: f64,
    /// Probability that a frame comes twice.
    pub repeat_frame: f64,
    /// Probability that a frame comes after the next one.
    pub swap_frames: f64,
    /// Mean time between two stalls of one direction, in seconds; 0 for none.
    pub stall_every_s: f64,
    /// Longest stall, in seconds.
    pub stall_s: f64,
    /// Mean time until a connection is cut, in seconds; 0 for never.
    pub cut_every_s: f64,
}

/// Counts of the faults so far.
#[derive(Debug, Default)]
pub struct Counted {
    pub connections: AtomicU64,
    pub bytes: AtomicU64,
    pub frames: AtomicU64,
    pub flipped_bits: AtomicU64,
    pub lost_bytes: AtomicU64,
    pub lost_frames: AtomicU64,
    pub repeated_frames: AtomicU64,
    pub swapped_frames: AtomicU64,
    pub stalls: AtomicU64,
    pub cuts: AtomicU64,
}

impl std::fmt::Display for Counted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let n = |count: &AtomicU64| count.load(Relaxed);
        write!(
            f,
            "{} connections, {:.1} MB in {} frames; {} bits flipped, {} bytes and {} frames lost, {} repeated, {} swapped, \
             {} stalls, {} cuts",
            n(&self.connections),
            n(&self.bytes) as f64 * 1e-6,
            n(&self.frames),
            n(&self.flipped_bits),
            n(&self.lost_bytes),
            n(&self.lost_frames),
            n(&self.repeated_frames),
            n(&self.swapped_frames),
            n(&self.stalls),
            n(&self.cuts)
        )
    }
}

struct Shared {
    to: SocketAddr,
    faults: Faults,
    counted: Counted,
    stop: AtomicBool,
}

/// The cable.
pub struct Proxy {
    address: SocketAddr,
    shared: Arc<Shared>,
}

impl Proxy {
    /// Listens on a port of its own and passes on to `to`.
    pub fn start(to: SocketAddr, faults: Faults) -> io::Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0")?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let shared = Arc::new(Shared {
            to,
            faults,
            counted: Counted::default(),
            stop: AtomicBool::new(false),
        });
        let own = Arc::clone(&shared);
        thread::spawn(move || accept(&listener, &own));
        Ok(Self { address, shared })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub fn counted(&self) -> &Counted {
        &self.shared.counted
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.shared.stop.store(true, Relaxed);
    }
}

fn accept(listener: &TcpListener, shared: &Arc<Shared>) {
    let mut number = 0;
    while !shared.stop.load(Relaxed) {
        match listener.accept() {
            Ok((near, _)) => {
                number += 1;
                // A far end that is not there ends this connection, as a refused one.
                let _ = connect(near, shared, number);
            }
            Err(_) => thread::sleep(Duration::from_millis(5)),
        }
    }
}

fn connect(near: TcpStream, shared: &Arc<Shared>, number: u64) -> io::Result<()> {
    let far = TcpStream::connect_timeout(&shared.to, Duration::from_secs(1))?;
    shared.counted.connections.fetch_add(1, Relaxed);
    let seed = shared
        .faults
        .seed
        .wrapping_mul(1_000_003)
        .wrapping_add(2 * number);
    let mut chance = Chance::new(seed);
    let lives_s = match shared.faults.cut_every_s {
        0.0 => 1e9,
        mean_s => chance.exponential(mean_s),
    };
    let ends = Instant::now() + Duration::from_secs_f64(lives_s.min(1e9));
    for (from, to, seed) in [
        (near.try_clone()?, far.try_clone()?, seed),
        (far, near, seed + 1),
    ] {
        from.set_nonblocking(false)?;
        from.set_read_timeout(Some(LOOK_EVERY))?;
        to.set_nodelay(true)?;
        let direction = Direction {
            shared: Arc::clone(shared),
            chance: Chance::new(seed),
            to,
            ends,
            held: Vec::new(),
            bits_to_flip: 0,
            bytes_to_lose: 0,
        };
        thread::spawn(move || direction.run(from));
    }
    Ok(())
}

/// One direction of one connection.
struct Direction {
    shared: Arc<Shared>,
    chance: Chance,
    to: TcpStream,
    ends: Instant,
    /// A frame that comes after the next one.
    held: Vec<u8>,
    bits_to_flip: u64,
    bytes_to_lose: u64,
}

impl Direction {
    fn run(mut self, mut from: TcpStream) {
        let faults = self.shared.faults;
        self.bits_to_flip = self.chance.failures(faults.flip);
        self.bytes_to_lose = self.chance.failures(faults.lose_byte);
        let _ = self.pass(&mut from);
        // The other direction ends with this one.
        let _ = from.shutdown(Shutdown::Both);
        let _ = self.to.shutdown(Shutdown::Both);
    }

    fn pass(&mut self, from: &mut TcpStream) -> io::Result<()> {
        let mut pending = Vec::new();
        let mut buf = [0; 16 * 1024];
        let mut stall_at = self.next_stall();
        loop {
            if self.shared.stop.load(Relaxed) {
                return Ok(());
            }
            let now = Instant::now();
            if now >= self.ends {
                self.shared.counted.cuts.fetch_add(1, Relaxed);
                return Ok(());
            }
            if stall_at.is_some_and(|at| now >= at) {
                self.shared.counted.stalls.fetch_add(1, Relaxed);
                let stall_s = self.chance.between(0.0, self.shared.faults.stall_s);
                thread::sleep(Duration::from_secs_f64(stall_s));
                stall_at = self.next_stall();
            }
            match from.read(&mut buf) {
                Ok(0) => return Ok(()),
                Ok(n) => {
                    pending.extend_from_slice(&buf[..n]);
                    self.frames(&mut pending)?;
                }
                Err(e) if is_timeout(&e) => {
                    // Nothing follows what was held back, or is incomplete.
                    let held = std::mem::take(&mut self.held);
                    self.give(&held)?;
                    let rest = std::mem::take(&mut pending);
                    self.give(&rest)?;
                }
                Err(e) => return Err(e),
            }
        }
    }

    fn next_stall(&mut self) -> Option<Instant> {
        let every_s = self.shared.faults.stall_every_s;
        (every_s > 0.0)
            .then(|| Instant::now() + Duration::from_secs_f64(self.chance.exponential(every_s)))
    }

    /// Passes on the whole frames of `pending`, and what is too long to be one.
    fn frames(&mut self, pending: &mut Vec<u8>) -> io::Result<()> {
        let mut from = 0;
        while let Some(length) = frame_length(&pending[from..]) {
            let frame = pending[from..from + length].to_vec();
            from += length;
            self.frame(frame)?;
        }
        pending.drain(..from);
        if pending.len() > MAX_FRAME_BYTES {
            let rest = std::mem::take(pending);
            self.give(&rest)?;
        }
        Ok(())
    }

    fn frame(&mut self, frame: Vec<u8>) -> io::Result<()> {
        let (faults, shared) = (self.shared.faults, Arc::clone(&self.shared));
        let counted = &shared.counted;
        counted.frames.fetch_add(1, Relaxed);
        if self.chance.happens(faults.lose_frame) {
            counted.lost_frames.fetch_add(1, Relaxed);
            return Ok(());
        }
        if self.held.is_empty() && self.chance.happens(faults.swap_frames) {
            counted.swapped_frames.fetch_add(1, Relaxed);
            self.held = frame;
            return Ok(());
        }
        self.give(&frame)?;
        if self.chance.happens(faults.repeat_frame) {
            counted.repeated_frames.fetch_add(1, Relaxed);
            self.give(&frame)?;
        }
        let held = std::mem::take(&mut self.held);
        self.give(&held)
    }

    /// Passes on bytes, some of them lost or with a flipped bit.
    fn give(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        let (faults, shared) = (self.shared.faults, Arc::clone(&self.shared));
        let counted = &shared.counted;
        let mut out = Vec::with_capacity(bytes.len());
        for &byte in bytes {
            if self.bytes_to_lose == 0 {
                self.bytes_to_lose = self.chance.failures(faults.lose_byte);
                counted.lost_bytes.fetch_add(1, Relaxed);
                continue;
            }
            self.bytes_to_lose -= 1;
            let mut byte = byte;
            while self.bits_to_flip < 8 {
                byte ^= 1 << self.bits_to_flip;
                counted.flipped_bits.fetch_add(1, Relaxed);
                self.bits_to_flip =
                    (self.bits_to_flip + 1).saturating_add(self.chance.failures(faults.flip));
            }
            self.bits_to_flip -= 8;
            out.push(byte);
        }
        counted.bytes.fetch_add(out.len() as u64, Relaxed);
        self.to.write_all(&out)
    }
}

/// Length of the frame at the front, its leading zeros included; none where it is not complete.
fn frame_length(bytes: &[u8]) -> Option<usize> {
    let begins = bytes.iter().position(|&b| b != 0)?;
    let length = bytes[begins..].iter().position(|&b| b == 0)?;
    Some(begins + length + 1)
}

fn is_timeout(e: &io::Error) -> bool {
    matches!(
        e.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}

/// A far end that takes everything down, and what a cable made of what was sent.
fn sent_through(faults: Faults, frames: &[Vec<u8>]) -> (Vec<u8>, Proxy) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let proxy = Proxy::start(listener.local_addr().unwrap(), faults).unwrap();
    let mut near = TcpStream::connect(proxy.address()).unwrap();
    let (mut far, _) = listener.accept().unwrap();
    let bytes = frames.concat();
    let sender = thread::spawn(move || {
        near.write_all(&bytes).unwrap();
        // What is held back comes when nothing follows.
        thread::sleep(Duration::from_millis(200));
        near.shutdown(Shutdown::Both).unwrap();
    });
    let mut taken = Vec::new();
    far.read_to_end(&mut taken).unwrap();
    sender.join().unwrap();
    (taken, proxy)
}

fn numbered_frames(count: u16) -> Vec<Vec<u8>> {
    let frame = |k: u16| {
        let body = [1 + (k % 250) as u8, 1 + (k / 250) as u8, 0x55, 0xAA];
        [&[0][..], &body, &body, &body, &[0]].concat()
    };
    (0..count).map(frame).collect()
}

#[test]
fn each_fault_comes_as_often_as_asked_and_is_counted() {
    let frames = numbered_frames(20_000);
    let all = frames.concat();
    let near = |count: &AtomicU64, expected: f64| {
        let n = count.load(Relaxed) as f64;
        assert!(
            (n - expected).abs() < 6.0 * expected.sqrt(),
            "{n} against {expected}"
        );
        n as usize
    };
    let faults = Faults {
        seed: 3,
        flip: 1e-4,
        ..Faults::default()
    };
    let (taken, proxy) = sent_through(faults, &frames);
    let flipped = near(&proxy.counted().flipped_bits, 8e-4 * all.len() as f64);
    let differing: u32 = taken
        .iter()
        .zip(&all)
        .map(|(a, b)| (a ^ b).count_ones())
        .sum();
    assert_eq!((taken.len(), differing as usize), (all.len(), flipped));

    let faults = Faults {
        seed: 4,
        lose_byte: 1e-3,
        ..Faults::default()
    };
    let (taken, proxy) = sent_through(faults, &frames);
    let lost = near(&proxy.counted().lost_bytes, 1e-3 * all.len() as f64);
    assert_eq!(taken.len() + lost, all.len());

    let length = frames[0].len();
    let faults = Faults {
        seed: 5,
        lose_frame: 0.01,
        ..Faults::default()
    };
    let (taken, proxy) = sent_through(faults, &frames);
    let lost = near(&proxy.counted().lost_frames, 200.0);
    assert_eq!(taken.len() / length, frames.len() - lost);

    let faults = Faults {
        seed: 6,
        repeat_frame: 0.01,
        swap_frames: 0.01,
        ..Faults::default()
    };
    let (taken, proxy) = sent_through(faults, &frames);
    let repeated = near(&proxy.counted().repeated_frames, 200.0);
    let swapped = near(&proxy.counted().swapped_frames, 200.0);
    let came: Vec<_> = taken.chunks(length).collect();
    assert_eq!(came.len(), frames.len() + repeated);
    let mut once = came.clone();
    once.dedup();
    assert_eq!(once.len(), frames.len());
    let moved = once
        .iter()
        .zip(&frames)
        .filter(|(a, b)| **a != &b[..])
        .count();
    // A swap moves two frames.
    assert!(
        moved > swapped && moved <= 2 * swapped,
        "{moved} of {swapped}"
    );
}
