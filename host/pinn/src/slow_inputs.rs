//! Further inputs of the RL-MLP beside the mains' phase, such as the frequency of a moving carrier, if R and L depend on
//! them.

/// Functions of time at evenly spaced times, linear between them and constant beyond.
#[derive(Clone, Debug, PartialEq)]
pub struct SlowInputs {
    /// Time of the first values after the mains zero crossing in seconds.
    pub t0_s: f64,
    /// Time from one value to the next in seconds.
    pub dt_s: f64,
    /// Values of each function at each time, best within -1..=1; all functions have the same number.
    pub functions: Vec<Vec<f64>>,
}

impl SlowInputs {
    /// Values of the functions at `t_s` seconds after the mains zero crossing.
    pub(crate) fn at(&self, t_s: f64) -> impl Iterator<Item = f64> {
        let place = ((t_s - self.t0_s) / self.dt_s).max(0.0);
        self.functions.iter().map(move |values| {
            let last = values.len().saturating_sub(1);
            let k = (place as usize).min(last);
            let value = |k: usize| values.get(k.min(last)).copied().unwrap_or(0.0);
            let share = (place - k as f64).min(1.0);
            value(k) + share * (value(k + 1) - value(k))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_the_times_they_are_linear_and_beyond_constant() {
        let inputs = SlowInputs {
            t0_s: 1e-3,
            dt_s: 1e-3,
            functions: vec![vec![0.0, 1.0, -1.0], vec![5.0, 5.0, 6.0]],
        };
        let at = |t_s: f64| inputs.at(t_s).collect::<Vec<_>>();
        assert_eq!(at(0.0), [0.0, 5.0]);
        assert_eq!(at(2.5e-3), [0.0, 5.5]);
        assert_eq!(at(9.0), [-1.0, 6.0]);
    }
}
