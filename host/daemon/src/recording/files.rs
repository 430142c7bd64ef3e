//! Names and list of the recordings in their folder.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::time::UNIX_EPOCH;

use ihd_model::RecordingFile;

/// File extension of recordings.
const EXTENSION: &str = ".mcap";

/// Length of `-2026-11-22T08-30-00.123`, in bytes.
const TIMESTAMP: usize = 24;

/// Longest name of a recording, in bytes.
const MAX_NAME: usize = 200;

/// Returns the free bytes of a folder's disk; `None` if they are not known, as on Windows.
pub fn free_bytes(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let disk = nix::sys::statvfs::statvfs(folder).ok()?;
        Some(disk.blocks_available() as u64 * disk.fragment_size() as u64)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

/// Returns the file name of a recording that begins at `at_ms`, as `bench-2026-11-22T08-30-00.123.mcap`.
pub fn file_name(device: &str, at_ms: i64) -> String {
    let time = jiff::Timestamp::from_millisecond(at_ms)
        .map_or_else(|_| at_ms.to_string(), |time| format!("{time:.3}"));
    let time = time.replace(':', "-");
    let name = format!(
        "{}-{}{EXTENSION}",
        file_safe_name(device),
        time.trim_end_matches('Z')
    );
    debug_assert!(Path::new(&name).components().count() == 1);
    name
}

/// Returns a device's name with all characters replaced that are unsafe in file names.
fn file_safe_name(device: &str) -> String {
    let plain = |c: char| match c {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '-' | '_' => c,
        _ => '-',
    };
    device.chars().map(plain).collect()
}

/// Returns `true` if a name can be that of a recording, and is no path out of the folder.
pub fn is_plain_name(name: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.');
    name.len() <= MAX_NAME
        && name.len() > EXTENSION.len()
        && name.ends_with(EXTENSION)
        && !name.starts_with('.')
        && name.bytes().all(plain)
}

/// Lists the recordings of a folder, newest first. `devices` are the known devices, `under_way` the names of incomplete
/// files. A missing folder is empty.
///
/// # Errors
/// Error of the operating system.
pub fn list(
    folder: &Path,
    devices: &[String],
    under_way: &[String],
) -> io::Result<Vec<RecordingFile>> {
    let known: BTreeMap<String, &String> = devices.iter().map(|d| (file_safe_name(d), d)).collect();
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries?,
    };
    let mut all = Vec::new();
    for entry in entries {
        let entry = entry?;
        let Ok(file) = entry.file_name().into_string() else {
            continue;
        };
        // Fails if the file was deleted meanwhile.
        let Ok(metadata) = entry.metadata() else {
            continue;
        };
        if !is_plain_name(&file) || !metadata.is_file() {
            continue;
        }
        let written = metadata.modified()?.duration_since(UNIX_EPOCH);
        let stem = file.strip_suffix(EXTENSION).unwrap_or(&file);
        let device = stem
            .len()
            .checked_sub(TIMESTAMP)
            .and_then(|n| stem.get(..n));
        let device = device
            .filter(|_| ends_with_timestamp(stem))
            .unwrap_or_default();
        all.push(RecordingFile {
            device: known.get(device).map_or(device, |name| name).to_owned(),
            at_ms: written.map_or(0, |since| since.as_millis() as i64),
            bytes: metadata.len(),
            under_way: under_way.contains(&file),
            file,
        });
    }
    all.sort_by(|a, b| (b.at_ms, &b.file).cmp(&(a.at_ms, &a.file)));
    Ok(all)
}

/// Returns `true` if a name without extension ends with a timestamp as in [`file_name`].
fn ends_with_timestamp(stem: &str) -> bool {
    let pattern = b"-dddd-dd-ddTdd-dd-dd.ddd";
    let tail = stem
        .len()
        .checked_sub(TIMESTAMP)
        .map(|n| &stem.as_bytes()[n..]);
    tail.is_some_and(|tail| {
        let fits = |(p, b): (&u8, &u8)| {
            if *p == b'd' {
                b.is_ascii_digit()
            } else {
                p == b
            }
        };
        pattern.iter().zip(tail).all(fits)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_named_by_device_and_time_whatever_the_device_is_called() {
        let name = file_name("usb:12/../x", 1_795_336_200_123);
        assert_eq!(name, "usb-12----x-2026-11-22T08-30-00.123.mcap");
        assert!(is_plain_name(&name));
    }

    #[test]
    fn a_name_is_no_way_out_of_the_folder() {
        for bad in [
            "",
            ".mcap",
            "..mcap",
            "../a.mcap",
            "/etc/a.mcap",
            "a/b.mcap",
            "a\\b.mcap",
            "C:a.mcap",
            "a.mcap\0",
            "ä.mcap",
            "a.csv",
            "tokens",
        ] {
            assert!(!is_plain_name(bad), "{bad}");
        }
        assert!(!is_plain_name(&format!("{}.mcap", "a".repeat(200))));
    }

    #[test]
    fn recordings_are_listed_newest_first_with_their_device() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(list(&dir.path().join("none"), &[], &[]).unwrap(), []);
        let old = file_name("usb:12", 1_795_336_200_123);
        let new = file_name("gone", 1_795_336_300_456);
        for (k, name) in [&old, &new].into_iter().enumerate() {
            let path = dir.path().join(name);
            fs::write(&path, vec![0; 10 * (k + 1)]).unwrap();
            let at = UNIX_EPOCH + std::time::Duration::from_secs(1_000 + k as u64);
            fs::File::options()
                .append(true)
                .open(&path)
                .unwrap()
                .set_modified(at)
                .unwrap();
        }
        for name in ["notes.txt", "copied.mcap"] {
            fs::write(dir.path().join(name), "x").unwrap();
        }
        fs::create_dir(dir.path().join("folder.mcap")).unwrap();
        let all = list(
            dir.path(),
            &["usb:12".to_owned()],
            std::slice::from_ref(&new),
        )
        .unwrap();
        let expected = |file: &str, device: &str, at_ms, bytes, under_way| RecordingFile {
            file: file.to_owned(),
            device: device.to_owned(),
            at_ms,
            bytes,
            under_way,
        };
        assert_eq!(
            (all[0].file.as_str(), all[0].device.as_str()),
            ("copied.mcap", "")
        );
        assert_eq!(all[1], expected(&new, "gone", 1_001_000, 20, true));
        assert_eq!(all[2], expected(&old, "usb:12", 1_000_000, 10, false));
        assert_eq!(all.len(), 3);
    }
}
