//! Export of windows to files for other programs: a recording of each boot, or a capture of each window.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use ihd_capture::exports::ExportError;
use ihd_capture::format;
use ihd_capture::mcap::{McapFileError, SessionRecorder};
use ihd_link::{FrameSink, Window};
use ihd_shared::window::{CHUNK_BYTES, PAIR_BYTES, TRAJECTORY_ENTRY_BYTES};
use ihd_shared::wire::frame::{CRC32, MAX_ENCODED, encode};
use ihd_shared::wire::hello::{ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{
    FrontEnd, Message, Raw, TrajectoryChunk, WindowChunk, WindowEnd, WindowStart,
};
use ihd_signal::{Capture, FrequencyStep, TimeBase, current_transformer};

use super::clock::rfc3339;
use super::{SessionRow, StoreError, StoreReader, WindowFilter, WindowRow};

/// File format of an export.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExportFormat {
    /// One recording a device and boot, as `ihd record` writes it.
    Mcap,
    /// One table a window.
    Csv,
    /// One archive of arrays a window.
    Npz,
    /// One Parquet file a window.
    Parquet,
}

impl ExportFormat {
    /// Returns the ending of its files, without the dot.
    pub fn ending(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Csv => "csv",
            Self::Npz => "npz",
            Self::Parquet => "parquet",
        }
    }
}

/// Result of an export.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct ExportReport {
    /// The files.
    pub files: Vec<PathBuf>,
    /// Windows in them.
    pub windows: u64,
    /// Windows that match the filter and whose samples are not stored.
    pub without_samples: u64,
}

/// Writes the windows that match a filter: into a folder, which is created if it does not exist, or, if `to` has
/// the format's ending, into that one file. No file is ever overwritten. `each` is called for every window.
///
/// # Errors
/// [`StoreError::Exists`]; [`StoreError::NotOneFile`]; [`StoreError::Export`]; or an error of the store.
pub fn windows(
    reader: &StoreReader,
    filter: &WindowFilter,
    format: ExportFormat,
    to: &Path,
    each: &mut dyn FnMut(),
) -> Result<ExportReport, StoreError> {
    let ending = format.ending();
    format::check(&to.join(format!("a.{ending}")))?;
    let mut exported = ExportReport::default();
    let boots = by_boot(reader.windows(filter)?).into_iter();
    let boots: Vec<_> = boots
        .map(|(of, rows)| (of, with_samples(rows, &mut exported)))
        .filter(|(_, rows)| !rows.is_empty())
        .collect();
    let files = match format {
        ExportFormat::Mcap => boots.len(),
        _ => boots.iter().map(|(_, rows)| rows.len()).sum(),
    };
    let one = to
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case(ending));
    if one && files != 1 {
        let path = to.to_owned();
        return Err(StoreError::NotOneFile { path, files });
    }
    let path_of = |name: String| match one {
        true => free(to.to_owned()),
        false => free(to.join(format!("{name}.{ending}"))),
    };
    if !one {
        std::fs::create_dir_all(to).map_err(StoreError::files(to, "making the folder"))?;
    }
    for ((device, boot), rows) in boots {
        let name = format!("{}-{boot}", file_name(&device));
        if format == ExportFormat::Mcap {
            let path = path_of(name)?;
            let session = reader.session_of(&device, boot)?;
            let written = recording(reader, &rows, session.as_ref(), &path, each)?;
            exported.windows += written;
            exported.without_samples += rows.len() as u64 - written;
            exported.files.push(path);
        } else {
            for row in &rows {
                let path = path_of(format!("{name}-{}", row.seq))?;
                let Some(window) = reader.window(&device, boot, row.seq)? else {
                    // A daemon has deleted them meanwhile.
                    exported.without_samples += 1;
                    continue;
                };
                format::write(&capture(row, &window), &path, &mut |_| ())?;
                exported.windows += 1;
                exported.files.push(path);
                each();
            }
        }
    }
    Ok(exported)
}

fn by_boot(rows: Vec<WindowRow>) -> BTreeMap<(String, u32), Vec<WindowRow>> {
    let mut boots: BTreeMap<(String, u32), Vec<WindowRow>> = BTreeMap::new();
    for row in rows {
        let boot = boots.entry((row.device.clone(), row.boot)).or_default();
        boot.push(row);
    }
    boots
}

/// Returns the rows with samples in the order of the half-cycles; counts the others.
fn with_samples(mut rows: Vec<WindowRow>, exported: &mut ExportReport) -> Vec<WindowRow> {
    let all = rows.len();
    rows.retain(|row| row.not_kept.is_none());
    exported.without_samples += (all - rows.len()) as u64;
    rows.sort_by_key(|row| (row.half_cycle, row.seq));
    rows
}

/// Turns a device's name into a part of a file name: letters, digits, and dots, dashes and underscores but not in front.
fn file_name(device: &str) -> String {
    let plain = |c: char| match c {
        '-' | '_' | '.' => c,
        c if c.is_ascii_alphanumeric() => c,
        _ => '_',
    };
    let name: String = device.chars().map(plain).collect();
    match name.trim_start_matches('.') {
        "" => "device".to_owned(),
        name => name.to_owned(),
    }
}

fn free(path: PathBuf) -> Result<PathBuf, StoreError> {
    match std::fs::symlink_metadata(&path) {
        Ok(_) => Err(StoreError::Exists { path }),
        Err(_) => Ok(path),
    }
}

/// Builds a capture of one window; time counts from the mains zero crossing.
pub fn capture(row: &WindowRow, window: &Window) -> Capture {
    let note = |key: &str, value: String| (key.to_owned(), value);
    let single = |x: Vec<f64>| x.into_iter().map(|x| x as f32).collect();
    Capture {
        name: format!("{} boot {} window {}", row.device, row.boot, row.seq),
        time: TimeBase::Even {
            t0_s: window.pair_time_s(0),
            dt_s: window.dt_s(),
        },
        v_v: single(window.v_volt()),
        i_a: single(window.i_ampere()),
        v_full_scale_v: Some(window.scales.v_full_scale_v()),
        i_full_scale_a: Some(window.scales.i_full_scale_a()),
        f_sw: vec![FrequencyStep {
            t_s: 0.0,
            f_sw_hz: f64::from(window.f_sw_hz),
        }],
        mains_hz: Some(window.f_mains_hz()),
        zero_crossing_s: Some(0.0),
        truth: Vec::new(),
        metadata: BTreeMap::from([
            note("device", row.device.clone()),
            note("device_boot_id", row.boot.to_string()),
            note("window_seq", row.seq.to_string()),
            note("half_cycle", row.half_cycle.to_string()),
            note("stored", rfc3339(row.at_ms)),
            current_transformer::metadata_entry(),
        ]),
    }
}

/// Writes a boot's windows as a recording: the frames that a device of this build would have sent, through the
/// recorder of `ihd record`. Returns the number of windows in it.
fn recording(
    reader: &StoreReader,
    rows: &[WindowRow],
    session: Option<&SessionRow>,
    path: &Path,
    each: &mut dyn FnMut(),
) -> Result<u64, StoreError> {
    let written = (|| {
        let Some(first) = rows.first() else {
            return Ok(0);
        };
        let mut windows = 0;
        let (hello, front_end) = identity(first.boot, session);
        let failed = |e: McapFileError| StoreError::Export(ExportError::Mcap(e));
        let recorder = SessionRecorder::create(path, &hello, &front_end).map_err(failed)?;
        let mut frames = Frames {
            recorder,
            // Frame 0 is the hello, which the recorder has written.
            next: 1,
            at: Duration::ZERO,
        };
        for row in rows {
            if let Some(window) = reader.window(&row.device, row.boot, row.seq)? {
                let since_ms = row.at_ms.saturating_sub(first.at_ms);
                let at = Duration::from_millis(u64::try_from(since_ms).unwrap_or(0));
                frames.at = frames.at.max(at);
                frames.window(&window).map_err(|e| write_error(path, &e))?;
                windows += 1;
            }
            each();
        }
        let finished = Box::new(frames.recorder).finish();
        finished
            .map(|()| windows)
            .map_err(|e| write_error(path, &e))
    })();
    if written.is_err() {
        // An incomplete file would look complete. A failure to remove it is not reported beside the first error.
        let _ = std::fs::remove_file(path);
    }
    written
}

fn write_error(path: &Path, error: &std::io::Error) -> StoreError {
    StoreError::Export(ExportError::Write {
        path: path.to_owned(),
        what: error.to_string(),
    })
}

/// Builds the device's identity at the start of a recording. The frames are of this build, and so are the versions.
fn identity(
    boot: u32,
    session: Option<&SessionRow>,
) -> (ihd_shared::wire::messages::Hello, FrontEnd) {
    use ihd_shared::sampling::{CODE_BITS, I_FULL_SCALE_MA, V_FULL_SCALE_MV};
    let (build, board, capabilities) = session.map_or(("unknown", "unknown", 0), |s| {
        (s.build.as_str(), s.board.as_str(), s.capabilities)
    });
    let front_end = FrontEnd {
        v_full_scale_mv: session.map_or(V_FULL_SCALE_MV, |s| s.v_full_scale_mv),
        i_full_scale_ma: session.map_or(I_FULL_SCALE_MA, |s| s.i_full_scale_ma),
        bus_full_scale_mv: 0,
        mains_full_scale_mv: 0,
        bits: session.map_or(CODE_BITS, |s| s.bits),
    };
    (
        ours(ROLE_DEVICE, capabilities, boot, build, board),
        front_end,
    )
}

/// Writer of frames into a recording.
struct Frames {
    recorder: SessionRecorder,
    next: u16,
    at: Duration,
}

impl Frames {
    fn send<M: Message>(&mut self, message: &M) -> std::io::Result<()> {
        let mut frame = [0; MAX_ENCODED];
        let length = encode(message, self.next, &mut frame).map_err(std::io::Error::other)?;
        self.next = self.next.wrapping_add(1);
        self.recorder.received(self.at, &frame[..length])
    }

    fn window(&mut self, window: &Window) -> std::io::Result<()> {
        let (pairs, trajectory) = (window.pair_bytes(), window.trajectory_bytes());
        let seq = window.seq;
        self.send(&start(window)?)?;
        for (k, data) in pairs.chunks(CHUNK_BYTES).enumerate() {
            let offset = offset(k, PAIR_BYTES)?;
            let data = Raw(data);
            self.send(&WindowChunk { seq, offset, data })?;
        }
        for (k, data) in trajectory.chunks(CHUNK_BYTES).enumerate() {
            let offset = offset(k, TRAJECTORY_ENTRY_BYTES)?;
            let data = Raw(data);
            self.send(&TrajectoryChunk { seq, offset, data })?;
        }
        let mut digest = CRC32.digest();
        digest.update(&pairs);
        digest.update(&trajectory);
        let crc32 = digest.finalize();
        self.send(&WindowEnd { seq, crc32 })
    }
}

/// Returns the index of the first entry of chunk `k`.
fn offset(k: usize, entry_bytes: usize) -> std::io::Result<u16> {
    u16::try_from(k * CHUNK_BYTES / entry_bytes).map_err(std::io::Error::other)
}

fn start(window: &Window) -> std::io::Result<WindowStart> {
    let count = |n: usize| u16::try_from(n).map_err(std::io::Error::other);
    Ok(WindowStart {
        seq: window.seq,
        dropped: 0,
        half_cycle: window.half_cycle,
        f_sw_hz: window.f_sw_hz,
        half_cycle_ns: window.half_cycle_ns,
        first_pair_ns: window.first_pair_ns,
        first_trajectory_ns: window.first_trajectory_ns,
        pairs: count(window.pairs.len())?,
        trajectory: count(window.trajectory.len())?,
        saturated: window.saturated,
        lookup_version: window.lookup_version,
        v_full_scale_mv: window.scales.v_full_scale_mv,
        i_full_scale_ma: window.scales.i_full_scale_ma,
    })
}
