//! Recordings by the daemon: the device's recorder is attached to each of its links.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ihd_capture::recording::{StartedRecording, StoppedRecording};
use ihd_link::LinkError;
use ihd_model::{CommandError, CommandReply, RecordSettings};

use super::request::ReplySender;
use super::session::{DeviceSession, SessionEnd};
use crate::device_record::DeviceRecord;
use crate::printable::printable;

impl DeviceSession<'_> {
    /// Attaches the recorder to the link, from now on.
    ///
    /// # Errors
    /// Error of the link.
    pub(super) async fn attach_recorder(&mut self) -> Result<(), LinkError> {
        let recorder = self.record.recorder.clone();
        let attached = self.link.client.with(move |client| {
            let (hello, front_end) = (client.hello().clone(), client.front_end().clone());
            let sink = recorder.connected(&hello, &front_end, client.clock());
            client.record_to(sink);
            client.limit_floods();
        });
        attached.await
    }

    /// Begins a recording or arms its trigger. The reply waits for the disk, the session does not.
    pub(super) async fn start_recording(&mut self, settings: RecordSettings, reply: ReplySender) {
        let recorder = self.record.recorder.clone();
        let starting = self
            .link
            .client
            .with(move |client| recorder.start(settings, client.clock()));
        let started = match starting.await {
            Ok(started) => started,
            Err(error) => Err(error.to_string()),
        };
        reply_from_disk(self.record, reply, move || {
            let started: StartedRecording = started?;
            started.wait()?;
            Ok(CommandReply {
                file: started.file.map(|file| file.display().to_string()),
                ..CommandReply::with_text(started.text)
            })
        });
    }

    /// Detaches the recorder at the end of the session. At the stop of the daemon the recording ends; otherwise it waits for the
    /// next connection.
    pub(super) async fn detach_recorder(&mut self, end: &SessionEnd) {
        if self.record.is_unplugged.load(Ordering::Relaxed) {
            // The recorder may be attached to the next link of the board already.
            return;
        }
        let recorder = self.record.recorder.clone();
        if *end != SessionEnd::Stopping {
            return recorder.disconnected();
        }
        if let Ok(stopped) = recorder.stop("the daemon stopped") {
            // The recorder reports a failure itself.
            let _ = tokio::task::spawn_blocking(move || stopped.wait()).await;
        }
    }
}

/// Ends the recording of a device or disarms its trigger, connected or not.
pub(super) fn stop(record: &Arc<DeviceRecord>, reply: ReplySender) {
    let stopped = record.recorder.stop("ended by hand");
    reply_from_disk(record, reply, move || {
        let stopped: StoppedRecording = stopped?;
        stopped.wait()?;
        let text = match &stopped.file {
            Some(_) => "recorded",
            None => "its trigger did not come: nothing was recorded",
        };
        Ok(CommandReply {
            file: stopped.file.map(|file| file.display().to_string()),
            ..CommandReply::with_text(text)
        })
    });
}

/// Sends the outcome as reply, from a blocking thread, because it waits for the disk.
fn reply_from_disk(
    record: &Arc<DeviceRecord>,
    reply: ReplySender,
    outcome: impl FnOnce() -> Result<CommandReply, String> + Send + 'static,
) {
    let name = record.name.clone();
    tokio::task::spawn_blocking(move || {
        let outcome = outcome().map_err(|why| CommandError::Refused {
            name,
            why: printable(&why),
        });
        // Fails only if the requester has left.
        let _ = reply.send(outcome);
    });
}
