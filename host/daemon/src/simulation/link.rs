//! The link between the daemon and a hob: frames in their order, some lost, doubled or late, until it is cut.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{LinkError, Transport};
use ihd_shared::wire::deframer::Deframer;
use rand::RngExt;

use super::world::{HOBS, World};

/// Step in which somebody waits for a hob.
const STEP: Duration = Duration::from_millis(10);

/// Longest time that frames are held up.
const LATEST_MS: u64 = 3_000;

/// One connection.
pub struct Link {
    world: Arc<World>,
    socket: usize,
    connection: u64,
    deframer: Deframer,
    /// Bytes of a frame that is not whole yet.
    going: Vec<u8>,
    /// The transport's clock where it is ahead of the world's: a request waits on it.
    ahead: Duration,
    /// Frames of the hob are held up until then.
    late_until: Duration,
    coming: VecDeque<u8>,
}

impl Link {
    /// Connects to the hob of this name.
    ///
    /// # Errors
    /// It is not plugged in.
    pub fn connect(world: &Arc<World>, name: &str) -> Result<Self, LinkError> {
        let socket = HOBS.iter().position(|hob| *hob == name);
        let socket = socket.expect("a name of this world");
        let mut state = world.lock();
        let place = &mut state.sockets[socket];
        if !place.is_plugged {
            return Err(LinkError::Connect {
                device: name.to_owned(),
                hint: String::new(),
                source: std::io::ErrorKind::NotFound.into(),
            });
        }
        place.connection += 1;
        place.hob.forget_sent();
        Ok(Self {
            socket,
            connection: place.connection,
            deframer: Deframer::new(),
            going: Vec::new(),
            ahead: Duration::ZERO,
            late_until: Duration::ZERO,
            coming: VecDeque::new(),
            world: Arc::clone(world),
        })
    }

    fn check(&self) -> Result<(), LinkError> {
        let state = self.world.lock();
        let place = &state.sockets[self.socket];
        match place.is_plugged && place.connection == self.connection {
            true => Ok(()),
            false => Err(LinkError::Closed {
                device: self.describe(),
            }),
        }
    }

    /// The next frame of the hob that has left by now, and has not been lost; empty where one was.
    fn next_frame(&mut self, now: Duration) -> Option<Vec<u8>> {
        if now < self.late_until {
            return None;
        }
        let state = &mut *self.world.lock();
        let place = &mut state.sockets[self.socket];
        place.hob.live_until(now);
        let frame = place.hob.take_sent(now)?;
        if place.late > 0.0 && state.rng.random_bool(place.late) {
            let late = Duration::from_millis(state.rng.random_range(1..LATEST_MS));
            self.late_until = now + late;
        }
        let is_lost = place.is_mute || place.lost > 0.0 && state.rng.random_bool(place.lost);
        let is_doubled = place.doubled > 0.0 && state.rng.random_bool(place.doubled);
        Some(match (is_lost, is_doubled) {
            (true, _) => Vec::new(),
            (false, true) => frame.repeat(2),
            (false, false) => frame,
        })
    }
}

impl Transport for Link {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.check()?;
        let now = self.clock();
        for &byte in bytes {
            self.going.push(byte);
            if !matches!(self.deframer.push(byte), Some(Ok(_))) {
                continue;
            }
            let frame = std::mem::take(&mut self.going);
            let times = {
                let state = &mut *self.world.lock();
                let place = &mut state.sockets[self.socket];
                place.hob.live_until(now);
                let is_lost =
                    place.is_mute || place.lost > 0.0 && state.rng.random_bool(place.lost);
                let is_doubled = place.doubled > 0.0 && state.rng.random_bool(place.doubled);
                match (is_lost, is_doubled) {
                    (true, _) => 0,
                    (false, true) => 2,
                    (false, false) => 1,
                }
            };
            for _ in 0..times {
                self.world.deliver(self.socket, &frame);
            }
        }
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let deadline = self.clock() + timeout;
        loop {
            self.check()?;
            let now = self.clock();
            while let Some(frame) = self.next_frame(now) {
                self.coming.extend(frame);
            }
            if !self.coming.is_empty() {
                let n = self.coming.len().min(buf.len());
                for (to, byte) in buf.iter_mut().zip(self.coming.drain(..n)) {
                    *to = byte;
                }
                return Ok(n);
            }
            if now >= deadline {
                return Ok(0);
            }
            self.ahead = (now + STEP).min(deadline);
        }
    }

    fn describe(&self) -> String {
        format!("simulated:{}", HOBS[self.socket])
    }

    fn clock(&self) -> Duration {
        self.world.now().max(self.ahead)
    }
}
