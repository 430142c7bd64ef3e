//! The daemon on bad links, with hostile devices, killed and for long: `host/ihd/tests/daemon`, which `cargo test` leaves
//! out because it takes minutes.

use crate::workspace::{Workspace, run};

const TESTS: &str = "--test daemon -- --include-ignored --nocapture";

/// At a time: they wait more than they work; what is measured is measured alone.
const SHORT: &str = "--test-threads=4";
const ALONE: &str = "--test-threads=1";

/// What the long form changes; each may also be set by hand.
const FULL: [(&str, &str); 7] = [
    ("IHD_KILLS", "200"),
    ("IHD_HOBS", "3"),
    ("IHD_SOAK_S", "864"),
    ("IHD_SOAK_SPEED", "100"),
    ("IHD_MANY_S", "300"),
    ("IHD_HOSTILE_S", "60"),
    ("IHD_HEALTHY_S", "1"),
];

/// Runs those tests whose name contains `only`; in `full`, 24 h of simulated time and 200 kills.
pub fn test(on: &Workspace, only: Option<&str>, full: bool) -> anyhow::Result<()> {
    let mut test = on.whole("test", TESTS);
    test.arg(if full { ALONE } else { SHORT }).args(only);
    for (name, value) in FULL {
        if full && std::env::var_os(name).is_none() {
            test.env(name, value);
        }
    }
    run(&mut test)
}
