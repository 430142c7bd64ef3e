//! Captures with several defects at once.

use ihd_sim::pot::{PotBase, SimulatedPot};
use ihd_sim::recording::settings::{
    CaptureSpec, CarrierSweep, LoadKind, Neighbour, RecordingChange, RecordingEvent,
};

use super::case::{Case, as_device, at_rate, with};
use super::damage::CaptureDamage;

/// All cases.
pub(super) fn all() -> Vec<Case> {
    [skews(), sensors(), loads_and_carriers()].concat()
}

fn faulty(name: &str, change: impl FnOnce(&mut CaptureSpec)) -> Case {
    Case::faulty(name, with(change))
}

fn skews() -> Vec<Case> {
    vec![
        faulty("skew 37 ns, 30 dB", |s| {
            s.sensing.skew_s = 37e-9;
            s.sensing.snr_db = Some(30.0);
        }),
        faulty("skew 37 ns, a real stage", |s| {
            s.sensing.skew_s = 37e-9;
            s.bus_capacitance_f = 5e-6;
            s.dead_s = 0.5e-6;
            s.sensing.ringing = 0.1;
            s.bridge_r_ohm = 0.02;
        }),
        faulty("skew 60 ns at 61/3", |s| {
            as_device(s);
            s.sensing.skew_s = 60e-9;
        }),
        faulty("skew 60 ns at 2.5 MS/s", |s| {
            at_rate(s, 2.5e6);
            s.sensing.skew_s = 60e-9;
        }),
        faulty("skew 60 ns, field model", |s| {
            s.load = LoadKind::Field;
            s.sensing.skew_s = 60e-9;
        }),
    ]
}

fn sensors() -> Vec<Case> {
    vec![
        faulty("probe of 1 MHz, skew -30 ns, 40 dB", |s| {
            s.sensing.i_pole_hz = 1e6;
            s.sensing.skew_s = -30e-9;
            s.sensing.snr_db = Some(40.0);
        }),
        faulty("droop 1 kHz, offsets, 8 bit", |s| {
            s.sensing.i_droop_hz = 1e3;
            (s.sensing.v_offset_v, s.sensing.i_offset_a) = (12.0, 3.0);
            s.sensing.bits = 8;
        }),
        faulty("saturation 120 A at 61/3", |s| {
            as_device(s);
            s.sensing.i_saturation_a = 120.0;
        }),
    ]
}

fn loads_and_carriers() -> Vec<Case> {
    vec![
        faulty("sweep ±1 kHz at 1 kHz, skew 60 ns", |s| {
            s.sweep = Some(CarrierSweep {
                deviation_hz: 1e3,
                rate_hz: 1e3,
            });
            s.sensing.skew_s = 60e-9;
        }),
        faulty("sweep ±5 kHz at 100 Hz, 30 dB, mains 60 Hz", |s| {
            s.sweep = Some(CarrierSweep {
                deviation_hz: 5e3,
                rate_hz: 100.0,
            });
            s.sensing.snr_db = Some(30.0);
            s.mains_hz = 60.0;
        }),
        faulty("neighbour, skew 20 ns, stainless", |s| {
            s.load = LoadKind::Surrogate;
            s.pot = SimulatedPot::new(PotBase::Stainless, 0.21);
            s.f_sw_hz = 67e3;
            s.neighbour = Some(Neighbour {
                offset_hz: 1.2e3,
                v: 4.0,
            });
            s.sensing.skew_s = 20e-9;
        }),
        faulty("R ×.6, L ×1.35, 30 dB", |s| {
            s.events = vec![RecordingEvent {
                t_s: 5e-3,
                change: RecordingChange::Load {
                    r_factor: 0.6,
                    l_factor: 1.35,
                },
            }];
            s.sensing.snr_db = Some(30.0);
        }),
        faulty("4 ms, skew 60 ns, distorted 60 Hz", |s| {
            s.duration_s = 14e-3;
            s.mains_hz = 60.0;
            s.mains_harmonics = [0.05, -0.03, 0.02];
            s.sensing.skew_s = 60e-9;
        })
        .damaged(CaptureDamage::Begins(10e-3)),
    ]
}
