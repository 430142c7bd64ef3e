//! Last report of the fleet, for API and terminal.

use std::sync::{Arc, Mutex};

use ihd_model::FleetReport;

use crate::locking::lock;
use crate::printable::printable;

/// Last fleet report; `None` while the daemon belongs to no fleet.
#[derive(Debug, Default)]
pub(crate) struct FleetView(Mutex<Option<Arc<FleetReport>>>);

impl FleetView {
    /// Returns the last report.
    pub fn get(&self) -> Option<Arc<FleetReport>> {
        lock(&self.0).clone()
    }

    /// Replaces the report. Its texts come from other machines: control characters are escaped, long texts cut.
    pub fn set(&self, report: FleetReport) {
        *lock(&self.0) = Some(Arc::new(made_printable(report)));
    }
}

fn made_printable(mut report: FleetReport) -> FleetReport {
    let mut texts = vec![&mut report.server, &mut report.edge, &mut report.why];
    for worker in &mut report.workers {
        texts.extend([&mut worker.name, &mut worker.version]);
    }
    for edge in &mut report.edges {
        texts.extend([&mut edge.name, &mut edge.version]);
        texts.extend(&mut edge.alarms);
    }
    texts.extend(&mut report.alarms);
    for device in &mut report.devices {
        texts.extend([&mut device.name, &mut device.edge, &mut device.state]);
        texts.extend([&mut device.pot, &mut device.build]);
    }
    for text in texts {
        *text = printable(text);
    }
    report
}
