//! Interpolation between points.

/// Interpolates y over rising x linearly, constant beyond the ends; `None` without points.
pub fn linear(x: &[f64], y: &[f64], at: f64) -> Option<f64> {
    let above = x.partition_point(|x| *x < at);
    let (before, after) = (
        above.saturating_sub(1),
        above.min(x.len().saturating_sub(1)),
    );
    let (a, b) = (*y.get(before)?, *y.get(after)?);
    let width = x[after] - x[before];
    if width <= 0.0 || at < x[before] {
        return Some(b);
    }
    Some(a + (b - a) * ((at - x[before]) / width).clamp(0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_linear_between_the_points_and_constant_beyond() {
        assert_eq!(linear(&[0.0, 1.0], &[1.0, 3.0], 0.25), Some(1.5));
        assert_eq!(linear(&[0.0, 1.0], &[1.0, 3.0], 9.0), Some(3.0));
        assert_eq!(linear(&[0.0, 1.0], &[1.0, 3.0], -9.0), Some(1.0));
        assert_eq!(linear(&[], &[], 0.0), None);
    }
}
