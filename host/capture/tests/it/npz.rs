//! NPZ of our own: all that it holds is read back.

use std::collections::BTreeMap;

use ihd_capture::OpenOptions;
use ihd_capture::open::open;
use ihd_signal::truth::PeriodTruth;
use ihd_signal::{Capture, FrequencyStep, TimeBase};

#[test]
fn a_capture_is_read_back_with_all_its_facts() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.npz");
    let period = |t_s| PeriodTruth {
        t_s,
        f_sw_hz: 45e3,
        r_ohm: [1.0, 2.0, 3.0, 4.0],
        l_h: [1e-6, 2e-6, 3e-6, 4e-6],
        i_a: 20.0,
        r_power_ohm: 1.25,
        p_w: 600.0,
    };
    let step = |t_s, f_sw_hz| FrequencyStep { t_s, f_sw_hz };
    let (t0_s, dt_s) = (-1e-3, 1e-7);
    for time in [
        TimeBase::Even { t0_s, dt_s },
        TimeBase::Stamps(vec![0.0, 1e-6, 2e-6, 9e-6]),
    ] {
        let written = Capture {
            name: path.display().to_string(),
            time,
            v_v: vec![1.0, -2.5, 3.0, 640.0],
            i_a: vec![0.5, 0.25, -80.0, 0.0],
            v_full_scale_v: Some(640.0),
            i_full_scale_a: Some(80.5),
            f_sw: vec![step(-1e-3, 45e3), step(1e-3, 50e3)],
            mains_hz: Some(50.0),
            zero_crossing_s: Some(2.5e-3),
            truth: vec![period(0.0), period(22e-6)],
            metadata: BTreeMap::from([("notes".to_owned(), "µ of a test".to_owned())]),
        };
        ihd_capture::write(&written, &path, &mut |_| ()).unwrap();
        let mut read = open(&path, &OpenOptions::default()).unwrap();
        assert_eq!(read.metadata.remove("format").as_deref(), Some("NumPy NPZ"));
        assert_eq!(read, written);
    }
}
