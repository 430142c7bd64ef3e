//! How the network came to what it says.

use std::collections::VecDeque;

use ihd_store::{ResultFilter, ResultRow};

use super::finite;
use crate::daemon::{Daemon, DaemonError};
use crate::model::Fit;

/// Fits of a device that are remembered with their steps.
const REMEMBERED: usize = 64;

/// Most fits of a list.
const MAX_FITS: usize = 10_000;

/// The last fits of a device, with what the store does not keep.
#[derive(Default)]
pub struct Fits(VecDeque<Fit>);

impl Fits {
    /// One more, that is in the store.
    pub fn push(&mut self, fit: Fit) {
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(fit);
    }

    fn of(&self, row: &ResultRow) -> Option<&Fit> {
        let mut newest = self.0.iter().rev();
        newest.find(|fit| (fit.boot, fit.seq) == (row.boot, row.seq))
    }
}

impl Daemon {
    /// The last fits of a device, newest first: with their steps those of the last minutes, as the store has them the
    /// others.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or what the store reports.
    pub async fn training(&self, device: &str, limit: usize) -> Result<Vec<Fit>, DaemonError> {
        let limit = u32::try_from(limit.min(MAX_FITS)).unwrap_or(u32::MAX);
        let rows = self.read_of(device, move |reader, device| {
            reader.results(&ResultFilter {
                device: Some(device.to_owned()),
                limit: Some(limit),
                ..ResultFilter::default()
            })
        });
        let rows = rows.await?;
        let handle = self.inner.devices.get(device);
        let fits = handle.as_ref().map(|handle| handle.face.fits());
        let fit = |row: &ResultRow| {
            let known = fits.as_ref().and_then(|fits| fits.of(row));
            let at_ms = row.at_ms;
            known.map_or_else(
                || of_row(row),
                |fit| Fit {
                    at_ms,
                    ..fit.clone()
                },
            )
        };
        Ok(rows.iter().map(fit).collect())
    }
}

/// A fit of which no more is known than the store keeps.
fn of_row(row: &ResultRow) -> Fit {
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
