//! Link between the daemon and a hob: frames in order, some lost, duplicated or delayed, until it is cut.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use ihd_link::{LinkError, Transport};
use ihd_shared::wire::deframer::Deframer;
use rand::RngExt;

use super::hob::HOBS;
use super::world::World;

/// Time step of waiting for a hob.
const STEP: Duration = Duration::from_millis(10);

/// Longest delay of frames, in milliseconds.
const MAX_DELAY_MS: u64 = 3_000;

/// Connection to a hob.
pub struct SimulatedLink {
    world: Arc<World>,
    socket: usize,
    connection: u64,
    deframer: Deframer,
    /// Bytes of an incomplete frame of the host.
    outgoing: Vec<u8>,
    /// Clock of the transport if it is ahead of the world's: a request waits on it.
    ahead: Duration,
    /// World's time until which frames of the hob are delayed.
    delayed_until: Duration,
    incoming: VecDeque<u8>,
}

impl SimulatedLink {
    /// Connects to the hob of this name.
    ///
    /// # Errors
    /// [`LinkError::Connect`] if the hob is unplugged.
    pub fn connect(world: &Arc<World>, name: &str) -> Result<Self, LinkError> {
        let socket = HOBS.iter().position(|hob| *hob == name);
        let socket = socket.expect("a name of this world");
        let mut state = world.lock();
        let socket_state = &mut state.sockets[socket];
        if !socket_state.is_plugged {
            return Err(LinkError::Connect {
                device: name.to_owned(),
                hint: String::new(),
                source: std::io::ErrorKind::NotFound.into(),
            });
        }
        socket_state.connection += 1;
        socket_state.hob.discard_sent();
        Ok(Self {
            socket,
            connection: socket_state.connection,
            deframer: Deframer::new(),
            outgoing: Vec::new(),
            ahead: Duration::ZERO,
            delayed_until: Duration::ZERO,
            incoming: VecDeque::new(),
            world: Arc::clone(world),
        })
    }

    fn check(&self) -> Result<(), LinkError> {
        let state = self.world.lock();
        let socket_state = &state.sockets[self.socket];
        match socket_state.is_plugged && socket_state.connection == self.connection {
            true => Ok(()),
            false => Err(LinkError::Closed {
                device: self.describe(),
            }),
        }
    }

    /// Returns the next frame that the hob has sent by now; empty if the frame was lost.
    fn next_frame(&mut self, now: Duration) -> Option<Vec<u8>> {
        if now < self.delayed_until {
            return None;
        }
        let state = &mut *self.world.lock();
        let socket_state = &mut state.sockets[self.socket];
        socket_state.hob.advance_to(now);
        let frame = socket_state.hob.take_sent(now)?;
        if socket_state.delay_chance > 0.0 && state.rng.random_bool(socket_state.delay_chance) {
            let delay = Duration::from_millis(state.rng.random_range(1..MAX_DELAY_MS));
            self.delayed_until = now + delay;
        }
        let is_lost = socket_state.is_mute
            || socket_state.loss_chance > 0.0 && state.rng.random_bool(socket_state.loss_chance);
        let is_doubled = socket_state.duplicate_chance > 0.0
            && state.rng.random_bool(socket_state.duplicate_chance);
        Some(match (is_lost, is_doubled) {
            (true, _) => Vec::new(),
            (false, true) => frame.repeat(2),
            (false, false) => frame,
        })
    }
}

impl Transport for SimulatedLink {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.check()?;
        let now = self.clock();
        for &byte in bytes {
            self.outgoing.push(byte);
            if !matches!(self.deframer.push(byte), Some(Ok(_))) {
                continue;
            }
            let frame = std::mem::take(&mut self.outgoing);
            let times = {
                let state = &mut *self.world.lock();
                let socket_state = &mut state.sockets[self.socket];
                socket_state.hob.advance_to(now);
                let is_lost = socket_state.is_mute
                    || socket_state.loss_chance > 0.0
                        && state.rng.random_bool(socket_state.loss_chance);
                let is_doubled = socket_state.duplicate_chance > 0.0
                    && state.rng.random_bool(socket_state.duplicate_chance);
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
                self.incoming.extend(frame);
            }
            if !self.incoming.is_empty() {
                let n = self.incoming.len().min(buf.len());
                for (to, byte) in buf.iter_mut().zip(self.incoming.drain(..n)) {
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
