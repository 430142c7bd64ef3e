//! This test binary run once more, as a process that may be killed or limited.

use std::path::Path;
use std::process::Command;

/// The folder that such a process writes to.
pub const FOLDER: &str = "IHD_STORE_TEST_FOLDER";

/// The command that runs one test of this binary as a writer to a folder, by way of a shell line in which
/// `"$@"` stands for it.
pub fn writer(test: &str, folder: &Path, shell: &str) -> Command {
    let mut command = Command::new("sh");
    command
        .args(["-c", shell, "sh"])
        .arg(std::env::current_exe().unwrap())
        .args(["--exact", test, "--nocapture", "--test-threads=1"])
        .env(FOLDER, folder);
    command
}
