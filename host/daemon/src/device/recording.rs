//! Recordings through the daemon: the device's recorder listens at each of its links.

use std::sync::Arc;

use ihd_link::LinkError;

use super::Answer;
use super::session::{Ended, Session};
use crate::face::Face;
use crate::model::{CommandError, Done, RecordSettings};
use crate::printable::printable;
use crate::recording::{Started, Stopped};

impl Session<'_> {
    /// From now on everything that comes and goes passes the recorder.
    pub(super) async fn listen(&mut self) -> Result<(), LinkError> {
        let recorder = self.face.recorder.clone();
        let listening = self.client.with(move |client| {
            let (hello, front_end) = (client.hello().clone(), client.front_end().clone());
            let sink = recorder.connected(&hello, &front_end, client.clock());
            client.record_to(sink);
            client.limit_floods();
        });
        listening.await
    }

    /// Begins a recording, or waits for its trigger; the answer waits for the disk, the session does not.
    pub(super) async fn start_recording(&mut self, settings: RecordSettings, answer: Answer) {
        let recorder = self.face.recorder.clone();
        let starting = self
            .client
            .with(move |client| recorder.start(settings, client.clock()));
        let started = match starting.await {
            Ok(started) => started,
            Err(error) => Err(error.to_string()),
        };
        answer_from_disk(self.face, answer, move || {
            let started: Started = started?;
            started.wait()?;
            Ok(Done {
                text: started.text,
                file: started.file.map(|file| file.display().to_string()),
            })
        });
    }

    /// At the end of the session: with the daemon the recording ends, with the link it waits for the next one.
    pub(super) async fn leave_recording(&mut self, ended: &Ended) {
        let recorder = self.face.recorder.clone();
        if *ended != Ended::Stopping {
            return recorder.disconnected();
        }
        if let Ok(stopped) = recorder.stop("the daemon stopped") {
            // Its failure is told where it happens.
            let _ = tokio::task::spawn_blocking(move || stopped.wait()).await;
        }
    }
}

/// Ends the recording of a device, or waits no longer for its trigger; whether the device is there or not.
pub(super) fn stop(face: &Arc<Face>, answer: Answer) {
    let stopped = face.recorder.stop("ended by hand");
    answer_from_disk(face, answer, move || {
        let stopped: Stopped = stopped?;
        stopped.wait()?;
        let text = match &stopped.file {
            Some(_) => "recorded",
            None => "its trigger did not come: nothing was recorded",
        };
        Ok(Done {
            text: text.to_owned(),
            file: stopped.file.map(|file| file.display().to_string()),
        })
    });
}

/// Gives an answer that waits for the disk, on a thread for that.
fn answer_from_disk(
    face: &Arc<Face>,
    answer: Answer,
    outcome: impl FnOnce() -> Result<Done, String> + Send + 'static,
) {
    let name = face.name.clone();
    tokio::task::spawn_blocking(move || {
        let outcome = outcome().map_err(|why| CommandError::Refused {
            name,
            why: printable(&why),
        });
        // Whoever left meanwhile does not want to know.
        let _ = answer.send(outcome);
    });
}
