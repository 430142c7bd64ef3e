//! Recordings through the daemon: an MCAP file of everything that comes.

use std::fs;
use std::path::Path;

use ihd_capture::mcap::SessionRecorder;

use super::session::Session;
use crate::board::now_ms;

impl Session<'_> {
    /// Begins a recording; the file's path.
    pub(super) async fn start_recording(&mut self) -> Result<String, String> {
        if let Some(file) = self.face.lock().recording.clone() {
            return Err(format!("{file} is being recorded into already"));
        }
        let folder = self.context.recordings.clone();
        let name = file_name(&self.face.name, now_ms());
        let (hello, front_end) = (self.client.hello().clone(), self.client.front_end().clone());
        let path = folder.join(name);
        let shown = path.display().to_string();
        let started = self.client.with(move |client| {
            fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
            let recorder = SessionRecorder::create(&path, &hello, &front_end)
                .map_err(|error| error.to_string())?
                .flushed_by_the_wall_clock();
            client.record_to(recorder);
            Ok::<_, String>(())
        });
        started.await.map_err(|error| error.to_string())??;
        tracing::info!(device = self.face.name, file = shown, "recording");
        self.face.lock().recording = Some(shown.clone());
        Ok(shown)
    }

    /// Ends the recording; the file's path.
    pub(super) async fn stop_recording(&mut self) -> Result<String, String> {
        let file = self.face.lock().recording.take();
        let file = file.ok_or("nothing is being recorded")?;
        let finished = self.client.with(|client| client.finish_recording()).await;
        finished
            .and_then(|finished| finished)
            .map_err(|error| format!("{file}: {error}"))?;
        tracing::info!(device = self.face.name, file, "recorded");
        Ok(file)
    }

    /// A recording that stopped by itself.
    pub(super) fn look_at_recording(&mut self) {
        let Some(error) = self.client.take_recording_failure() else {
            return;
        };
        let file = self.face.lock().recording.take().unwrap_or_default();
        tracing::warn!(device = self.face.name, file, %error, "recording");
        self.note("recording", &format!("{file}: {error}"));
    }

    /// At the end of the session, where one is under way.
    pub(super) async fn finish_recording(&mut self) {
        let recording = self.face.lock().recording.is_some();
        if recording && let Err(why) = self.stop_recording().await {
            // What was written is there to the last flush.
            tracing::warn!(
                device = self.face.name,
                why,
                "recording ended with the link"
            );
        }
    }
}

/// `bench-2026-11-22T08-30-00.123.mcap`.
fn file_name(device: &str, at_ms: i64) -> String {
    let plain = |c: char| match c {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '-' | '_' => c,
        _ => '-',
    };
    let device: String = device.chars().map(plain).collect();
    let time = jiff::Timestamp::from_millisecond(at_ms)
        .map_or_else(|_| at_ms.to_string(), |time| format!("{time:.3}"));
    let time = time.replace(':', "-");
    let name = format!("{device}-{}.mcap", time.trim_end_matches('Z'));
    debug_assert!(Path::new(&name).components().count() == 1);
    name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_by_device_and_time_whatever_the_device_is_called() {
        assert_eq!(
            file_name("usb:12/../x", 1_795_336_200_123),
            "usb-12----x-2026-11-22T08-30-00.123.mcap"
        );
    }
}
