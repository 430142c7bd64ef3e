//! Pieces of windows that got lost on the way, asked for again.

use std::time::Duration;

use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::messages::{Piece, ResendWindow};
use ihd_shared::wire::number::Number;

use super::Client;
use crate::LinkError;
use crate::receiver::DeviceEvent;
use crate::resend::ResendStep;

impl Client {
    /// Lets the device release the windows that were completed or rejected since there were `known` events.
    pub(super) fn release_windows(&mut self, known: usize) -> Result<(), LinkError> {
        let newest = self.receiver.events.iter().skip(known).rev();
        let seq = newest.into_iter().find_map(|event| match event {
            DeviceEvent::Window(window) => Some(window.seq),
            DeviceEvent::WindowRejected { seq, .. } => Some(*seq),
            DeviceEvent::Telemetry(_) | DeviceEvent::Fault(_) | DeviceEvent::Log { .. } => None,
        });
        // The device holds one window at a time: earlier ones are gone.
        let release = seq.map(|seq| ResendWindow {
            seq,
            piece: Piece::Nothing,
            offset: 0,
        });
        self.send_requests(release.as_slice())
    }

    /// Requests missing pieces of the window under way if they are due; returns the time until the next are.
    pub(super) fn ask_for_pieces(&mut self) -> Result<Duration, LinkError> {
        loop {
            let now = self.transport.clock();
            let window = self.receiver.unfinished();
            match self.resend.step(now, window.as_ref()) {
                ResendStep::Wait(pause) => return Ok(pause),
                ResendStep::GiveUp(seq) => self.receiver.give_up(seq),
                ResendStep::Ask(pieces) => {
                    self.pieces_asked = self.pieces_asked.wrapping_add(pieces.len() as u32);
                    self.send_requests(&pieces)?;
                }
            }
        }
    }

    fn send_requests(&mut self, requests: &[ResendWindow]) -> Result<(), LinkError> {
        let mut frames = Vec::new();
        for request in requests {
            let mut frame = [0; MAX_ENCODED];
            let length = self.framed(request, Number::NONE, &mut frame)?;
            self.tap.give(self.transport.clock(), &frame[..length]);
            frames.extend_from_slice(&frame[..length]);
        }
        if frames.is_empty() {
            return Ok(());
        }
        self.transport.send(&frames)
    }
}
