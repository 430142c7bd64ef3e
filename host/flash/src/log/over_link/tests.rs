//! The log over a link, from a scripted device.

use ihd_fakes::LogBoard;

use super::*;

/// Bytes of log before these, dropped frames, bytes.
type Logged = (u32, u32, &'static [u8]);

/// A board on a link whose clock goes on with what is waited for.
struct Device {
    board: LogBoard,
    bytes: Vec<u8>,
    time: Duration,
}

impl Device {
    fn boxed(logs: &[Logged]) -> Box<dyn Transport> {
        let logs = logs
            .iter()
            .map(|(seq, dropped, data)| (*seq, *dropped, data.to_vec()));
        Box::new(Self {
            board: LogBoard::new(7, logs.collect()),
            bytes: Vec::new(),
            time: Duration::ZERO,
        })
    }
}

impl Transport for Device {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        for &byte in bytes {
            self.bytes.extend(self.board.receive(byte));
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
    assert_eq!(running.crc, Some(2));
    assert_eq!(running.build, "ihd-firmware 9.8.7");
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
