//! File system of the guest in memory: a cpio archive of the format "newc" (Linux: buffer-format.rst).

use std::path::{Path, PathBuf};
use std::process::{self, Command};
use std::sync::atomic::{AtomicU32, Ordering};
use std::{env, fs};

use anyhow::{Context, ensure};

const FOLDER: u32 = 0o040_755;
const PROGRAM: u32 = 0o100_755;

/// Path of a temporary file of this test.
pub fn scratch() -> PathBuf {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let number = NEXT.fetch_add(1, Ordering::Relaxed);
    env::temp_dir().join(format!("ihd-guest-{}-{number}", process::id()))
}

/// Archive in the format "newc".
#[derive(Default)]
pub struct Archive {
    bytes: Vec<u8>,
    folders: Vec<PathBuf>,
    entries: u32,
}

impl Archive {
    fn entry(&mut self, name: &str, mode: u32, content: &[u8]) {
        self.entries += 1;
        let (length, name_length) = (content.len() as u32, name.len() as u32 + 1);
        // Inode, mode, owner, group, links, time, size, device, device of a node, length of the name, no checksum.
        let fields = [
            self.entries,
            mode,
            0,
            0,
            1,
            0,
            length,
            0,
            0,
            0,
            0,
            name_length,
            0,
        ];
        self.bytes.extend(b"070701");
        for field in fields {
            self.bytes.extend(format!("{field:08x}").bytes());
        }
        self.bytes.extend(name.bytes());
        self.bytes.push(0);
        self.align();
        self.bytes.extend(content);
        self.align();
    }

    fn align(&mut self) {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
    }

    fn folder(&mut self, path: &Path) {
        if path.as_os_str().is_empty() || self.folders.iter().any(|known| known == path) {
            return;
        }
        self.folder(path.parent().unwrap_or(Path::new("")));
        self.folders.push(path.to_owned());
        self.entry(&path.display().to_string(), FOLDER, &[]);
    }

    /// Adds an executable file, with its parent folders.
    pub fn file(&mut self, path: &str, content: &[u8]) {
        let path = path.trim_start_matches('/');
        self.folder(Path::new(path).parent().unwrap_or(Path::new("")));
        self.entry(path, PROGRAM, content);
    }

    /// Adds an empty folder.
    pub fn mount_point(&mut self, path: &str) {
        self.folder(Path::new(path));
    }

    /// Adds a program without its debug information, and its shared libraries.
    pub fn program(&mut self, path: &str, program: &Path) -> anyhow::Result<()> {
        let stripped = scratch();
        let strip = Command::new("strip")
            .arg("-o")
            .args([stripped.as_path(), program])
            .status();
        ensure!(
            strip.is_ok_and(|status| status.success()),
            "cannot strip {program:?}"
        );
        let content = fs::read(&stripped)?;
        fs::remove_file(&stripped)?;
        self.file(path, &content);
        let ldd = Command::new("ldd")
            .arg(program)
            .output()
            .context("cannot run ldd")?;
        for word in String::from_utf8_lossy(&ldd.stdout).split_whitespace() {
            let missing = !self.folders.iter().any(|known| known == Path::new(word));
            if word.starts_with('/') && missing {
                // Each library is added once.
                self.folders.push(word.into());
                self.file(word, &fs::read(word).with_context(|| word.to_owned())?);
            }
        }
        Ok(())
    }

    /// Closes the archive and returns its bytes.
    pub fn finish(mut self) -> Vec<u8> {
        self.entry("TRAILER!!!", 0, &[]);
        self.bytes
    }
}
