//! Processor load of a device, as one line and as JSON.

use ihd_shared::wire::messages::Utilisation;

/// Text; `None` if the device did not answer.
pub fn line(used: Option<&Utilisation>) -> String {
    let Some(used) = used else {
        return "not reported: the device did not answer".into();
    };
    let gap_ms = f64::from(used.longest_gap_us) * 1e-3;
    let shares = if used.blocks == 0 {
        "not measured by this board".into()
    } else {
        let percent = |permille: u16| f64::from(permille) * 0.1;
        format!(
            "{:.1} % for samples, {:.1} % in the busiest block",
            percent(used.mean_permille),
            percent(used.worst_permille)
        )
    };
    format!("{shares}; housekeeping's longest gap {gap_ms:.2} ms")
}

/// JSON object; null if the device did not answer, and null shares for a board that cannot measure them.
pub fn json(used: Option<&Utilisation>) -> serde_json::Value {
    let Some(used) = used else {
        return serde_json::Value::Null;
    };
    let measured = (used.blocks > 0).then_some(used);
    serde_json::json!({
        "blocks": used.blocks,
        "mean_permille": measured.map(|l| l.mean_permille),
        "worst_permille": measured.map(|l| l.worst_permille),
        "longest_gap_us": used.longest_gap_us,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_measured_is_not_shown_as_zero() {
        let used = Utilisation {
            blocks: 26_000,
            mean_permille: 459,
            worst_permille: 601,
            longest_gap_us: 1_240,
        };
        assert_eq!(
            line(Some(&used)),
            "45.9 % for samples, 60.1 % in the busiest block; housekeeping's longest gap 1.24 ms"
        );
        assert_eq!(json(Some(&used))["worst_permille"], 601);
        let blind = Utilisation {
            blocks: 0,
            mean_permille: 0,
            worst_permille: 0,
            ..used
        };
        assert!(line(Some(&blind)).starts_with("not measured by this board; "));
        assert!(json(Some(&blind))["mean_permille"].is_null());
        assert!(line(None).contains("did not answer"));
        assert!(json(None).is_null());
    }
}
