//! User's options for opening a capture.

use std::path::PathBuf;

use ihd_signal::TimeBase;

use super::channels::{ChannelOptions, ChannelRef};

/// User's options for a file, and for a second one with the other channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenOptions {
    /// File with the other channel, of one acquisition; its channels are numbered after the first's.
    pub second: Option<PathBuf>,
    /// Channels, units, ratios and signs.
    pub channels: ChannelOptions,
    /// Columns of a table: time (`-` for none), voltage, current; they replace [`ChannelOptions::channels`].
    pub columns: Option<[ChannelRef; 3]>,
    /// Sampling rate in hertz; replaces the file's time.
    pub rate_hz: Option<f64>,
}

/// Options that the reader of one file gets.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadOptions<'a> {
    /// Columns of a table: time (`-` for none), voltage, current.
    pub columns: Option<&'a [ChannelRef; 3]>,
    /// Set where a stated rate replaces the file's times: they are neither read nor judged.
    pub without_times: bool,
}

impl OpenOptions {
    /// Returns the options that the reader of one file gets.
    pub fn of_file(&self) -> ReadOptions<'_> {
        ReadOptions {
            columns: self.columns.as_ref(),
            without_times: self.rate_hz.is_some(),
        }
    }

    /// Returns the times by the stated rate, from `t0_s` seconds on; `None` if the file's times hold.
    pub fn stated_time(&self, t0_s: f64) -> Option<TimeBase> {
        let dt_s = 1.0 / self.rate_hz?;
        Some(TimeBase::Even { t0_s, dt_s })
    }
}
