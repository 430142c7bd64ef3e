//! Training: fits of windows by the network, step by step.

use ihd_model::Fit;
use ihd_store::{ResultFilter, ResultRow};

use super::{View, finite};
use crate::error::DaemonError;

/// Largest number of fits in a list.
const MAX_FITS: usize = 10_000;

impl View {
    /// Returns the last fits of a device, newest first: those of the last minutes with their steps, the others as
    /// stored.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn training(&self, device: &str, limit: usize) -> Result<Vec<Fit>, DaemonError> {
        let limit = u32::try_from(limit.min(MAX_FITS)).unwrap_or(u32::MAX);
        let rows = self.read_device(device, move |reader, device| {
            reader.results(&ResultFilter {
                device: Some(device.to_owned()),
                limit: Some(limit),
                ..ResultFilter::default()
            })
        });
        let rows = rows.await?;
        let handle = self.devices.get(device);
        let fits = handle.as_ref().map(|handle| handle.record.fits());
        let fit = |row: &ResultRow| {
            let known = fits.as_ref().and_then(|fits| fits.find(row));
            let at_ms = row.at_ms;
            known.map_or_else(
                || from_row(row),
                |fit| Fit {
                    at_ms,
                    ..fit.clone()
                },
            )
        };
        Ok(rows.iter().map(fit).collect())
    }
}

/// Builds a fit from its stored record.
fn from_row(row: &ResultRow) -> Fit {
    Fit {
        boot: row.boot,
        seq: row.seq,
        at_ms: row.at_ms,
        f_sw_hz: row.f_sw_hz,
        r_ohm: finite(row.r_ohm),
        l_h: finite(row.l_h),
        sigma_r_pct: finite(row.sigma_r_pct),
        sigma_l_pct: finite(row.sigma_l_pct),
        pass: row.pass,
        why: row.why.clone(),
        remarks: Vec::new(),
        changed_lookup: row.changed_lookup,
        iterations: row.iterations,
        seconds: None,
        steps: Vec::new(),
        r_error_pct: None,
        l_error_pct: None,
    }
}
