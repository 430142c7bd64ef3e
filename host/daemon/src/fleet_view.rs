//! What an edge knows of its fleet, kept for whoever asks the daemon.

use std::sync::{Arc, Mutex};

use crate::daemon::{Daemon, lock};
use crate::model::FleetReport;
use crate::printable::printable;

/// The last report, none while the daemon belongs to no fleet.
#[derive(Debug, Default)]
pub(crate) struct FleetView(Mutex<Option<Arc<FleetReport>>>);

impl FleetView {
    fn get(&self) -> Option<Arc<FleetReport>> {
        lock(&self.0).clone()
    }

    fn set(&self, report: FleetReport) {
        *lock(&self.0) = Some(Arc::new(report));
    }
}

impl Daemon {
    /// What is known of the fleet; none where this daemon is no edge of one.
    pub fn fleet(&self) -> Option<Arc<FleetReport>> {
        self.inner.fleet.get()
    }

    /// Takes what is known of the fleet now, in place of what was known: from here on this daemon is an edge. Names and
    /// words in it are other machines': what a terminal or a page could stumble over is replaced, what is very long is cut.
    pub fn tell_fleet(&self, report: FleetReport) {
        self.inner.fleet.set(made_printable(report));
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
