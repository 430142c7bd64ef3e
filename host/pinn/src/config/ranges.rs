//! The range of every setting.

use super::{Optimiser, PinnConfig};
use crate::impedance_law::MAX_ORDER;
use crate::{ImpedanceOrder, PinnError, SlowEmbedding, ViMlp};

impl PinnConfig {
    /// Checks every field against its documented range.
    ///
    /// # Errors
    /// [`PinnError::Config`] or [`PinnError::WarmStart`] for the first field out of range.
    pub fn validate(&self) -> Result<(), PinnError> {
        self.validate_harmonics()?;
        within("most_points", self.most_points, 1000..=10_000_000)?;
        within("spline_intervals", self.spline_intervals, 4..=400)?;
        within("slow_points", self.slow_points, 16..=4096)?;
        within("hidden_layers count", self.hidden_layers.len(), 1..=8)?;
        for width in &self.hidden_layers {
            within("hidden_layers width", *width, 1..=256)?;
        }
        within("outer_passes", self.outer_passes, 1..=100)?;
        within("max_iterations", self.max_iterations, 1..=10_000_000)?;
        self.validate_numbers()?;
        within("ensemble", self.ensemble, 1..=64)?;
        if self.at_once && self.ensemble > 1 {
            return wrong(
                "at_once",
                "finds the same in every member of an ensemble: give one of both",
            );
        }
        validate_embedding("embedding", self.embedding)?;
        self.validate_networks()?;
        self.validate_start()
    }

    fn validate_numbers(&self) -> Result<(), PinnError> {
        for (field, value) in [
            ("r_scale_ohm", self.r_scale_ohm),
            ("l_scale_h", self.l_scale_h),
            ("w_f", self.w_f),
            ("w_i", self.w_i),
            ("learning_rate", self.learning_rate),
            ("time_limit_s", self.time_limit_s),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return wrong(field, format!("is {value}, but must be a positive number"));
            }
        }
        for (field, value) in [
            ("weight_width", self.weight_width),
            ("tolerance", self.tolerance),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return wrong(field, format!("is {value}, but must be zero or positive"));
            }
        }
        let mut noise = self.noise.iter().flatten();
        match noise.find(|s| !(0.0..f64::MAX).contains(*s)) {
            None => Ok(()),
            Some(value) => wrong(
                "noise",
                format!("holds {value}, but must be zero or positive"),
            ),
        }
    }

    fn validate_networks(&self) -> Result<(), PinnError> {
        let Some(vi) = &self.vi_mlp else {
            if self.backend.is_double() {
                return Ok(());
            }
            let problem = format!(
                "{} has no double precision, which the harmonic branch needs: take fused or \
                 ndarray",
                self.backend
            );
            return wrong("backend", problem);
        };
        if self.optimiser != Optimiser::Adam {
            let problem =
                "must be adam with a VI-MLP: Levenberg-Marquardt is for the harmonic branch";
            return wrong("optimiser", problem);
        }
        validate_vi_mlp(vi)
    }

    fn validate_harmonics(&self) -> Result<(), PinnError> {
        let ascending = |list: &[u32]| list.windows(2).all(|pair| pair[0] < pair[1]);
        if self.harmonics.first() != Some(&1) || !ascending(&self.harmonics) {
            return wrong("harmonics", "must ascend from 1, the fundamental");
        }
        if self.harmonics.len() > 32 {
            return wrong("harmonics", "has more than 32 entries");
        }
        let fitted = |h| self.harmonics.contains(h);
        if self.physics_harmonics.is_empty()
            || !ascending(&self.physics_harmonics)
            || !self.physics_harmonics.iter().all(fitted)
        {
            return wrong(
                "physics_harmonics",
                "must be a non-empty ascending selection of harmonics",
            );
        }
        match self.impedance_order {
            ImpedanceOrder::Given(n) if !(0.0..=MAX_ORDER).contains(&n) => wrong(
                "impedance_order",
                format!("is {n}, but must be 0 to {MAX_ORDER}"),
            ),
            ImpedanceOrder::Named(_) if self.physics_harmonics.len() < 2 => wrong(
                "impedance_order",
                "is identified, but with one physics harmonic there is nothing to see it from: give \
                 two at least",
            ),
            _ => Ok(()),
        }
    }

    fn validate_start(&self) -> Result<(), PinnError> {
        let Some(start) = &self.start else {
            return Ok(());
        };
        let given = start.hidden_layers();
        if given == self.hidden_layers && start.is_sound() {
            return Ok(());
        }
        Err(PinnError::WarmStart {
            given: format!(
                "{given:?}{}",
                if start.is_sound() { "" } else { " (damaged)" }
            ),
            configured: format!("{:?}", self.hidden_layers),
        })
    }
}

/// The widths and counts of the VI-MLP.
fn validate_vi_mlp(vi: &ViMlp) -> Result<(), PinnError> {
    within("vi_mlp.hidden_layers count", vi.hidden_layers.len(), 1..=8)?;
    for width in &vi.hidden_layers {
        within("vi_mlp.hidden_layers width", *width, 1..=256)?;
    }
    within("vi_mlp.n_sw", vi.n_sw as usize, 1..=16)?;
    within("vi_mlp.first_m", vi.first_m as usize, 0..=16)?;
    within("vi_mlp.downsampling", vi.downsampling, 1..=1000)?;
    within("vi_mlp.balance_every", vi.balance_every, 0..=10_000_000)?;
    if let Some(minibatch) = vi.minibatch {
        within("vi_mlp.minibatch", minibatch, 16..=10_000_000)?;
    }
    if let Some(slow) = vi.slow {
        validate_embedding("vi_mlp.slow", slow)?;
    }
    if vi.last_rate.is_finite() && vi.last_rate > 0.0 && vi.last_rate <= 1.0 {
        Ok(())
    } else {
        wrong(
            "vi_mlp.last_rate",
            format!("is {}, but must be above 0 and up to 1", vi.last_rate),
        )
    }
}

fn validate_embedding(field: &'static str, embedding: SlowEmbedding) -> Result<(), PinnError> {
    match embedding {
        SlowEmbedding::MainsPhase | SlowEmbedding::Symmetric => Ok(()),
        SlowEmbedding::Fourier { first, count } => {
            within(field, first as usize, 0..=16)?;
            within(field, count as usize, 1..=16)
        }
    }
}

fn within(
    field: &'static str,
    value: usize,
    range: std::ops::RangeInclusive<usize>,
) -> Result<(), PinnError> {
    if range.contains(&value) {
        return Ok(());
    }
    let (from, to) = (range.start(), range.end());
    wrong(field, format!("is {value}, but must be {from} to {to}"))
}

fn wrong(field: &'static str, problem: impl Into<String>) -> Result<(), PinnError> {
    let problem = problem.into();
    Err(PinnError::Config { field, problem })
}
