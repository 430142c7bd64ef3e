//! Damage to a capture between the converters and the file.

use ihd_signal::{Capture, TimeBase};

/// Kind of damage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CaptureDamage {
    /// The recording begins at this time in seconds, with the hob running.
    Begins(f64),
    /// Voltage and current are exchanged.
    Swapped,
    /// The current probe is reversed.
    Inverted,
    /// Samples from the first time to the second, in seconds, are missing, and the rest is joined.
    Lost(f64, f64),
}

impl CaptureDamage {
    /// Applies the damage.
    pub fn apply(self, capture: &mut Capture) {
        match self {
            Self::Begins(t_s) => drop_between(capture, f64::NEG_INFINITY, t_s),
            Self::Swapped => std::mem::swap(&mut capture.v_v, &mut capture.i_a),
            Self::Inverted => capture.i_a.iter_mut().for_each(|i| *i = -*i),
            Self::Lost(from_s, to_s) => drop_between(capture, from_s, to_s),
        }
    }
}

/// Removes the samples from `from_s` up to `to_s`; the others keep their times.
fn drop_between(capture: &mut Capture, from_s: f64, to_s: f64) {
    let t_s: Vec<f64> = (0..capture.len())
        .filter_map(|k| capture.time.at(k))
        .collect();
    let from = t_s.partition_point(|t| *t < from_s);
    let to = t_s.partition_point(|t| *t < to_s);
    capture.v_v.drain(from..to);
    capture.i_a.drain(from..to);
    capture.time = match capture.time {
        TimeBase::Even { dt_s, .. } if from == 0 => TimeBase::Even {
            t0_s: t_s.get(to).copied().unwrap_or(0.0),
            dt_s,
        },
        _ => TimeBase::Stamps([&t_s[..from], &t_s[to..]].concat()),
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capture() -> Capture {
        Capture {
            name: "ten samples".into(),
            time: TimeBase::Even {
                t0_s: 0.0,
                dt_s: 1.0,
            },
            v_v: (0..10).map(|k| k as f32).collect(),
            i_a: (0..10).map(|k| 10.0 * k as f32).collect(),
            ..Capture::default()
        }
    }

    #[test]
    fn what_is_left_keeps_its_times() {
        let mut late = capture();
        CaptureDamage::Begins(2.5).apply(&mut late);
        assert_eq!(
            (late.len(), late.time.at(0), late.v_v[0]),
            (7, Some(3.0), 3.0)
        );
        let mut gap = capture();
        CaptureDamage::Lost(3.5, 6.5).apply(&mut gap);
        assert_eq!(gap.v_v, [0.0, 1.0, 2.0, 3.0, 7.0, 8.0, 9.0]);
        assert_eq!((gap.time.at(3), gap.time.at(4)), (Some(3.0), Some(7.0)));
    }

    #[test]
    fn probes_are_exchanged_and_turned() {
        let mut wrong = capture();
        CaptureDamage::Swapped.apply(&mut wrong);
        assert_eq!((wrong.v_v[1], wrong.i_a[1]), (10.0, 1.0));
        CaptureDamage::Inverted.apply(&mut wrong);
        assert_eq!(wrong.i_a[1], -1.0);
    }
}
