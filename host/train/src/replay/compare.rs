//! What two devices made of the same blocks, value by value.

use ihd_link::Window;
use ihd_shared::wire::messages::Telemetry;
use serde::Serialize;

/// Differences that are kept; the rest is counted.
pub const KEPT: usize = 20;

/// One value on which device and host do not agree.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// When, in seconds on the capture's clock.
    pub t_s: f64,
    /// What: `R`, `L`, `window track`, …
    pub what: String,
    /// The device's value.
    pub device: String,
    /// This build's value.
    pub host: String,
}

/// Compared and lost messages of one kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Compared {
    /// Compared.
    pub compared: u32,
    /// Lost on the link, so that there was nothing to compare.
    pub lost: u32,
}

/// What a replay gave.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Outcome {
    /// The device, in words.
    pub device: String,
    /// Stretches of one frequency.
    pub stretches: usize,
    /// Blocks of 61 pairs replayed.
    pub blocks: usize,
    /// Estimates of R and L compared; every block's is.
    pub estimates: usize,
    /// Windows.
    pub windows: Compared,
    /// Half-cycles' telemetry: state, fault, R and L at the crest, current, power, phase.
    pub telemetry: Compared,
    /// Messages sent or asked after again because the link lost something.
    pub repeats: u32,
    /// Times the link was made anew.
    pub reconnects: u32,
    /// All differences, in number.
    pub differences: usize,
    /// The first of them.
    pub first: Vec<Difference>,
    /// Wall time in seconds.
    pub seconds: f64,
}

impl Outcome {
    /// Whether nothing differs.
    pub fn is_identical(&self) -> bool {
        self.differences == 0
    }

    /// Notes a value, if it differs.
    pub fn value<T: PartialEq>(
        &mut self,
        t_s: f64,
        what: &str,
        device: T,
        host: T,
        words: impl Fn(&T) -> String,
    ) {
        if device == host {
            return;
        }
        self.differences += 1;
        if self.first.len() < KEPT {
            self.first.push(Difference {
                t_s,
                what: what.to_owned(),
                device: words(&device),
                host: words(&host),
            });
        }
    }

    /// Compares two windows of one half-cycle.
    pub fn windows(&mut self, t_s: f64, device: &Window, host: &Window) {
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
        self.value(t_s, "window header", head(device), head(host), |h| {
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
            self.value(t_s, "window pairs", text, String::new(), Clone::clone);
        }
        if device.trajectory != host.trajectory {
            let at = device
                .trajectory
                .iter()
                .zip(&host.trajectory)
                .position(|(a, b)| a != b);
            let text = unequal(device.trajectory.len(), host.trajectory.len(), at);
            self.value(t_s, "window track", text, String::new(), Clone::clone);
        }
    }

    /// Compares two telemetries of one half-cycle; counters and the lookup in force may differ.
    pub fn telemetries(&mut self, t_s: f64, device: &Telemetry, host: &Telemetry) {
        self.telemetry.compared += 1;
        let debug = |x: &i64| x.to_string();
        let states = |t: &Telemetry| {
            format!(
                "{:?}, {:?}, pot {:?}, limit {:?}",
                t.state, t.fault, t.pot, t.limit
            )
        };
        self.value(t_s, "state", states(device), states(host), Clone::clone);
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
            self.value(t_s, what, field(device), field(host), debug);
        }
    }
}
