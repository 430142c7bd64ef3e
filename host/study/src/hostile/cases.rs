//! Matrix of sound captures. Faulty ones are in [`super::faulty`] and [`super::combined`].

use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::recording::sensing::Rate;
use ihd_sim::recording::settings::{CaptureSpec, LoadKind, RecordingChange, RecordingEvent};

use super::case::{Case, aluminium, as_device, at_rate, base, with};
use super::damage::CaptureDamage;
use super::{combined, faulty};

/// All cases, the clean ones first.
pub fn all() -> Vec<Case> {
    [
        operating_points(),
        converters(),
        mains_and_length(),
        pots(),
        stages(),
        faulty::sensors(),
        faulty::loads_and_carriers(),
        faulty::files(),
        combined::all(),
    ]
    .concat()
}

fn operating_points() -> Vec<Case> {
    let at = |khz: f64| {
        with(|s| {
            s.f_sw_hz = khz * 1e3;
            // Below some 40 kHz the tank is near its resonance.
            s.sensing.i_full_scale_a = if khz < 40.0 { 160.0 } else { 80.0 };
            s.sensing.v_full_scale_v = if khz < 40.0 { 1280.0 } else { 640.0 };
        })
    };
    let mut cases = vec![Case::clean("45 kHz", base()).short()];
    for khz in [20.0, 25.0, 30.0, 36.0, 41.7, 55.0, 67.0, 80.0] {
        cases.push(Case::clean(format!("{khz} kHz"), at(khz)));
    }
    cases
}

fn converters() -> Vec<Case> {
    let mut cases = Vec::new();
    for rate in [1.0, 2.5, 6.0, 50.0, 125.0] {
        let case = Case::clean(
            format!("{rate} MS/s"),
            with(|s| {
                at_rate(s, rate * 1e6);
                s.dt_s = if rate > 60.0 { 8e-9 } else { 20e-9 };
            }),
        );
        cases.push(if rate == 2.5 { case.short() } else { case });
    }
    let slow = |s: &mut CaptureSpec| {
        at_rate(s, 2.5e6);
        s.f_sw_hz = 41.7e3;
    };
    cases.push(Case::clean("2.5 MS/s at 41.7 kHz", with(slow)));
    for bits in [8, 16] {
        cases.push(Case::clean(
            format!("{bits} bit"),
            with(|s| s.sensing.bits = bits),
        ));
    }
    for snr in [20.0, 30.0, 40.0, 70.0] {
        let case = Case::clean(format!("{snr} dB"), with(|s| s.sensing.snr_db = Some(snr)));
        cases.push(if snr == 30.0 { case.short() } else { case });
    }
    cases.push(Case::clean("no noise", with(|s| s.sensing.snr_db = None)));
    let exact = |s: &mut CaptureSpec| {
        s.sensing.snr_db = None;
        s.sensing.bits = 16;
        s.sensing.rate = Rate::Hz(50e6);
    };
    cases.push(Case::clean("50 MS/s, 16 bit, no noise", with(exact)));
    cases.push(Case::clean("61/3", with(as_device)).short());
    let device_at = |khz: f64, snr_db| {
        with(|s| {
            as_device(s);
            s.f_sw_hz = khz * 1e3;
            s.sensing.snr_db = snr_db;
        })
    };
    cases.push(Case::clean("61/3 at 41.7 kHz", device_at(41.7, None)));
    cases.push(Case::clean("61/3 at 67 kHz", device_at(67.0, None)));
    cases.push(Case::clean("61/3 at 30 dB", device_at(45.0, Some(30.0))));
    let coarse = |s: &mut CaptureSpec| {
        s.sensing.bits = 8;
        s.sensing.snr_db = Some(30.0);
        at_rate(s, 6e6);
    };
    cases.push(Case::clean("6 MS/s, 8 bit, 30 dB", with(coarse)));
    cases
}

fn mains_and_length() -> Vec<Case> {
    let distorted = [0.05, -0.03, 0.02];
    let mains = |hz: f64, harmonics| {
        with(|s| {
            s.mains_hz = hz;
            s.mains_harmonics = harmonics;
        })
    };
    let lasting = |duration_s: f64| with(|s| s.duration_s = duration_s);
    vec![
        Case::clean("mains 47 Hz", mains(47.0, [0.0; 3])).short(),
        Case::clean("mains 60 Hz", mains(60.0, [0.0; 3])),
        Case::clean("mains 50 Hz, distorted", mains(50.0, distorted)),
        Case::clean("mains 60 Hz, distorted", mains(60.0, distorted)),
        Case::clean("begins inside a half-cycle", lasting(23.3e-3))
            .damaged(CaptureDamage::Begins(3.3e-3)),
        Case::clean("4 ms around a crest", lasting(17e-3)).damaged(CaptureDamage::Begins(13e-3)),
        Case::clean("4 ms around a zero crossing", lasting(12e-3))
            .damaged(CaptureDamage::Begins(8e-3)),
        Case::clean("one half-cycle", lasting(10e-3)),
        Case::clean("five half-cycles", lasting(50e-3)),
    ]
}

fn pots() -> Vec<Case> {
    let reduced = |pot: SimulatedPot, khz: f64| {
        with(|s| {
            (s.load, s.winding_r_ohm) = (LoadKind::Surrogate, 0.1);
            s.pot = pot;
            s.f_sw_hz = khz * 1e3;
            s.sensing.snr_db = Some(60.0);
        })
    };
    let field = |pot: SimulatedPot, khz: f64| CaptureSpec {
        load: LoadKind::Field,
        ..reduced(pot, khz)
    };
    let lifted = SimulatedPot {
        lift_m: 10e-3,
        ..SimulatedPot::new(PotBase::Ferritic, 0.18)
    };
    let hot = SimulatedPot {
        temperature_c: 150.0,
        ..SimulatedPot::new(PotBase::Ferritic, 0.18)
    };
    vec![
        Case::clean(
            "ferritic 18 cm",
            reduced(SimulatedPot::new(PotBase::Ferritic, 0.18), 50.0),
        ),
        Case::clean(
            "ferritic 12 cm",
            reduced(SimulatedPot::new(PotBase::Ferritic, 0.12), 45.0),
        ),
        Case::clean(
            "cast iron 15 cm",
            reduced(SimulatedPot::new(PotBase::CastIron, 0.15), 45.0),
        ),
        Case::clean(
            "stainless",
            reduced(SimulatedPot::new(PotBase::Stainless, 0.21), 67.0),
        ),
        Case::clean("aluminium, 0.35 ohm", with(aluminium)).short(),
        Case::clean("empty coil", reduced(SimulatedPot::NONE, 45.0)),
        Case::clean("lifted 10 mm", reduced(lifted, 45.0)),
        Case::clean("at 150 °C", reduced(hot, 50.0)),
        Case::clean(
            "field model",
            field(SimulatedPot::new(PotBase::Ferritic, 0.21), 45.0),
        ),
        Case::clean(
            "field model at 67 kHz",
            field(SimulatedPot::new(PotBase::Ferritic, 0.21), 67.0),
        ),
        Case::clean(
            "field model, stainless",
            field(SimulatedPot::new(PotBase::Stainless, 0.21), 67.0),
        ),
    ]
}

fn stages() -> Vec<Case> {
    let step = |t_s, change| RecordingEvent { t_s, change };
    let whole = |s: &mut CaptureSpec| {
        s.bus_capacitance_f = 5e-6;
        s.dead_s = 0.5e-6;
        s.sensing.ringing = 0.1;
        s.bridge_r_ohm = 0.02;
    };
    vec![
        Case::clean("bus capacitor 5 µF", with(|s| s.bus_capacitance_f = 5e-6)),
        Case::clean("dead time 1 µs", with(|s| s.dead_s = 1e-6)),
        Case::clean("ringing", with(|s| s.sensing.ringing = 0.2)),
        Case::clean("bridge of 20 mΩ", with(|s| s.bridge_r_ohm = 0.02)),
        Case::clean("duty .35", with(|s| s.duty = 0.35)).short(),
        Case::clean("duty .6", with(|s| s.duty = 0.6)),
        Case::clean("a real stage", with(whole)).short(),
        Case::clean(
            "45 to 60 kHz at 10 ms",
            with(|s| s.events = vec![step(10e-3, RecordingChange::Frequency(60e3))]),
        ),
    ]
}
