//! Captures with one defect: of sensors, loads and carriers, or files.

use ihd_sim::recording::sensing::Sensing;
use ihd_sim::recording::settings::{
    CaptureSpec, CarrierSweep, Neighbour, RecordingChange, RecordingEvent,
};

use super::case::{Case, aluminium, base, with};
use super::damage::CaptureDamage;

fn sensing(change: impl FnOnce(&mut Sensing)) -> CaptureSpec {
    with(|s| change(&mut s.sensing))
}

/// Probes that distort the waveform.
pub(super) fn sensors() -> Vec<Case> {
    let skewed = |ns: f64| sensing(|s| s.skew_s = ns * 1e-9);
    let skewed_aluminium = |ns: f64| {
        with(|s| {
            aluminium(s);
            s.sensing.skew_s = ns * 1e-9;
        })
    };
    vec![
        Case::faulty("current probe of 100 kHz", sensing(|s| s.i_pole_hz = 100e3)),
        Case::faulty("current probe of 300 kHz", sensing(|s| s.i_pole_hz = 300e3)),
        Case::faulty("current probe of 1 MHz", sensing(|s| s.i_pole_hz = 1e6)).short(),
        Case::faulty("voltage probe of 1 MHz", sensing(|s| s.v_pole_hz = 1e6)),
        Case::faulty("skew 60 ns", skewed(60.0)).short(),
        Case::faulty("skew -60 ns", skewed(-60.0)),
        Case::faulty("skew 20 ns", skewed(20.0)),
        Case::faulty("skew -20 ns", skewed(-20.0)),
        Case::faulty("skew 1 µs", skewed(1000.0)),
        Case::faulty("skew 20 ns at 0.35 ohm", skewed_aluminium(20.0)).short(),
        Case::faulty("skew -60 ns at 0.35 ohm", skewed_aluminium(-60.0)),
        Case::faulty("saturation, 120 A", sensing(|s| s.i_saturation_a = 120.0)).short(),
        Case::faulty("saturation, 70 A", sensing(|s| s.i_saturation_a = 70.0)),
        Case::faulty("droop 100 Hz", sensing(|s| s.i_droop_hz = 100.0)),
        Case::faulty("droop 1 kHz", sensing(|s| s.i_droop_hz = 1e3)).short(),
        Case::faulty("droop 5 kHz", sensing(|s| s.i_droop_hz = 5e3)),
        Case::faulty("voltage gain +3 %", sensing(|s| s.v_gain = 1.03))
            .with_capacitance()
            .short(),
        Case::faulty("current gain -2 %", sensing(|s| s.i_gain = 0.98)).with_capacitance(),
        Case::invisible("voltage gain +3 %, C unknown", sensing(|s| s.v_gain = 1.03)),
        Case::faulty(
            "offsets 12 V, 3 A",
            sensing(|s| (s.v_offset_v, s.i_offset_a) = (12.0, 3.0)),
        ),
    ]
}

/// Loads that jump, carriers that move, other zones.
pub(super) fn loads_and_carriers() -> Vec<Case> {
    let load = |t_s, r_factor, l_factor| RecordingEvent {
        t_s,
        change: RecordingChange::Load { r_factor, l_factor },
    };
    let stepped = |events: Vec<RecordingEvent>| with(|s| s.events = events);
    let swept = |deviation_hz, rate_hz| {
        with(|s| {
            s.sweep = Some(CarrierSweep {
                deviation_hz,
                rate_hz,
            });
        })
    };
    let beside = |offset_hz, v| with(|s| s.neighbour = Some(Neighbour { offset_hz, v }));
    vec![
        Case::faulty("neighbour 1.2 kHz away, 8 V", beside(1.2e3, 8.0)).short(),
        Case::faulty("neighbour 5 kHz below, 15 V", beside(-5e3, 15.0)),
        Case::faulty("neighbour 300 Hz away, 4 V", beside(300.0, 4.0)),
        Case::faulty("sweep ±5 kHz at 100 Hz", swept(5e3, 100.0)).short(),
        Case::faulty("sweep ±1 kHz at 1 kHz", swept(1e3, 1e3)).short(),
        Case::faulty("sweep ±2 kHz at 37 Hz", swept(2e3, 37.0)),
        Case::faulty("dither ±500 Hz at 400 Hz", swept(500.0, 400.0)),
        Case::faulty(
            "R ×.6, L ×1.35 at 5 ms",
            stepped(vec![load(5e-3, 0.6, 1.35)]),
        )
        .short(),
        Case::faulty(
            "R ×3 for .3 ms",
            stepped(vec![load(5e-3, 3.0, 1.0), load(5.3e-3, 1.0, 1.0)]),
        ),
        Case::faulty("R ×1.3 at 14 ms", stepped(vec![load(14e-3, 1.3, 1.0)])),
        Case::faulty(
            "pot taken off at 12 ms",
            stepped(vec![RecordingEvent {
                t_s: 12e-3,
                change: RecordingChange::Pot(ihd_sim::pot::SimulatedPot::NONE),
            }]),
        ),
    ]
}

/// Ranges, connections and files.
pub(super) fn files() -> Vec<Case> {
    vec![
        Case::faulty(
            "current clips at 40 A",
            sensing(|s| s.i_full_scale_a = 40.0),
        )
        .short(),
        Case::faulty(
            "voltage clips at 300 V",
            sensing(|s| s.v_full_scale_v = 300.0),
        ),
        Case::faulty("2000 spikes a second", sensing(|s| s.spikes_per_s = 2e3)),
        Case::faulty("channels exchanged", base()).damaged(CaptureDamage::Swapped),
        Case::faulty("current inverted", base())
            .damaged(CaptureDamage::Inverted)
            .short(),
        Case::faulty("1 ms lost", base()).damaged(CaptureDamage::Lost(6.3e-3, 7.3e-3)),
    ]
}
