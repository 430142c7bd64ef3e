//! Comparison of two devices' results for the same blocks, value by value.

use ihd_link::Window;
use ihd_shared::wire::messages::Telemetry;
use serde::Serialize;

/// Differences that are listed; the rest is only counted.
pub const MAX_LISTED: usize = 20;

/// One value on which device and host do not agree.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayDifference {
    /// Time in seconds on the capture's clock.
    pub t_s: f64,
    /// Name of the value: `R`, `L`, `window track`, …
    pub what: String,
    /// The device's value.
    pub device: String,
    /// This build's value.
    pub host: String,
}

/// Numbers of compared and lost messages of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct MessageCounts {
    /// Messages that were compared.
    pub compared: u32,
    /// Messages that the link lost, which were not compared.
    pub lost: u32,
}

/// Stretches that were not replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct OmittedStretches {
    /// Stretches at a frequency outside the hob's ratings.
    pub out_of_range: usize,
    /// Stretches shorter than a block.
    pub short: usize,
    /// Samples of all of them.
    pub samples: usize,
}

/// Result of a replay.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Description of the device.
    pub device: String,
    /// Stretches replayed, each of one frequency.
    pub stretches: usize,
    /// Stretches that were not replayed.
    pub omitted: OmittedStretches,
    /// Blocks of 61 pairs replayed.
    pub blocks: usize,
    /// Pairs replayed at a limit of the front end's range: the capture goes beyond it.
    pub saturated: usize,
    /// Estimates of R and L compared, one a block.
    pub estimates: usize,
    /// Windows compared and lost.
    pub windows: MessageCounts,
    /// Telemetry of half-cycles compared and lost: state, fault, R and L at the crest, current, power, phase.
    pub telemetry: MessageCounts,
    /// Messages sent or requested again because the link lost something.
    pub repeats: u32,
    /// Reconnections of the link.
    pub reconnects: u32,
    /// Number of differences.
    pub differences: usize,
    /// First differences, at most [`MAX_LISTED`].
    pub first: Vec<ReplayDifference>,
    /// Wall time in seconds.
    pub seconds: f64,
}

impl ReplayReport {
    /// Returns `true` if nothing differs.
    pub fn is_identical(&self) -> bool {
        self.differences == 0
    }

    /// Returns `true` if no half-cycle was compared, neither its window nor its telemetry.
    pub fn is_without_half_cycles(&self) -> bool {
        self.windows.compared == 0 && self.telemetry.compared == 0
    }

    /// Compares a value and records a difference; `text` formats it.
    pub fn compare_value<T: PartialEq>(
        &mut self,
        t_s: f64,
        what: &str,
        device: T,
        host: T,
        text: impl Fn(&T) -> String,
    ) {
        if device == host {
            return;
        }
        self.differences += 1;
        if self.first.len() < MAX_LISTED {
            self.first.push(ReplayDifference {
                t_s,
                what: what.to_owned(),
                device: text(&device),
                host: text(&host),
            });
        }
    }

    /// Compares two windows of one half-cycle.
    pub fn compare_windows(&mut self, t_s: f64, device: &Window, host: &Window) {
        self.windows.compared += 1;
        let head = |w: &Window| {
            (
                w.f_sw_hz,
                w.half_cycle_ns,
                w.first_pair_ns,
                w.first_trajectory_ns,
                w.saturated,
            )
        };
        self.compare_value(t_s, "window header", head(device), head(host), |h| {
            format!("{h:?}")
        });
        let unequal = |a: usize, b: usize, at: Option<usize>| match at {
            Some(k) => format!("differs from {k} of {}", a.min(b)),
            None => format!("{a} entries"),
        };
        if device.pairs != host.pairs {
            let at = device
                .pairs
                .iter()
                .zip(&host.pairs)
                .position(|(a, b)| a != b);
            let text = unequal(device.pairs.len(), host.pairs.len(), at);
            self.compare_value(t_s, "window pairs", text, String::new(), Clone::clone);
        }
        if device.trajectory != host.trajectory {
            let at = device
                .trajectory
                .iter()
                .zip(&host.trajectory)
                .position(|(a, b)| a != b);
            let text = unequal(device.trajectory.len(), host.trajectory.len(), at);
            self.compare_value(t_s, "window track", text, String::new(), Clone::clone);
        }
    }

    /// Compares two telemetry messages of one half-cycle; counters and the active lookup may differ.
    pub fn compare_telemetry(&mut self, t_s: f64, device: &Telemetry, host: &Telemetry) {
        self.telemetry.compared += 1;
        let debug = |x: &i64| x.to_string();
        let states = |t: &Telemetry| {
            format!(
                "{:?}, {:?}, pot {:?}, limit {:?}",
                t.state, t.fault, t.pot, t.limit
            )
        };
        self.compare_value(t_s, "state", states(device), states(host), Clone::clone);
        for (what, field) in [
            ("f_sw, Hz", (|t| t.f_sw_hz.into()) as fn(&Telemetry) -> i64),
            ("R at the crest, µΩ", |t| t.r.0.into()),
            ("L at the crest, pH", |t| t.l.0.into()),
            ("current at the crest, mA", |t| t.i_crest_ma.into()),
            ("power, mW", |t| t.power_mw.into()),
            ("phase, mrad", |t| t.phase_mrad.into()),
            ("bus, dV", |t| t.bus_peak_dv.into()),
            ("coil voltage, dV", |t| t.v_coil_peak_dv.into()),
            ("turn-off, mA", |t| t.i_turn_off_min_ma.into()),
        ] {
            self.compare_value(t_s, what, field(device), field(host), debug);
        }
    }
}
