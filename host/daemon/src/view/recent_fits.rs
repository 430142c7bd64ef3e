//! Last fits of a device, with their steps.

use std::collections::VecDeque;

use ihd_model::Fit;
use ihd_store::ResultRow;

/// Number of fits of a device that are held with their steps.
const MAX_FITS: usize = 64;

/// Last fits of a device, with the steps, which the store does not hold.
#[derive(Default)]
pub struct RecentFits(VecDeque<Fit>);

impl RecentFits {
    /// Adds a stored fit.
    pub fn push(&mut self, fit: Fit) {
        if self.0.len() == MAX_FITS {
            self.0.pop_front();
        }
        self.0.push_back(fit);
    }

    /// Returns the fit of this result.
    pub(super) fn find(&self, row: &ResultRow) -> Option<&Fit> {
        let mut newest = self.0.iter().rev();
        newest.find(|fit| (fit.boot, fit.seq) == (row.boot, row.seq))
    }
}
