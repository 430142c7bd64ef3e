//! What an edge knows of its fleet, kept for whoever asks the daemon.

use std::sync::{Arc, Mutex, PoisonError};

use crate::daemon::Daemon;
use crate::model::FleetReport;
use crate::printable::printable;

/// The last report, none while the daemon belongs to no fleet.
#[derive(Debug, Default)]
pub(crate) struct FleetView(Mutex<Option<Arc<FleetReport>>>);

impl FleetView {
    fn get(&self) -> Option<Arc<FleetReport>> {
        self.0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
    }

    fn set(&self, report: FleetReport) {
        let report = Some(Arc::new(report));
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = report;
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
    }
    for device in &mut report.devices {
        texts.extend([&mut device.name, &mut device.edge, &mut device.state]);
        texts.extend([&mut device.pot, &mut device.build]);
    }
    for text in texts {
        *text = printable(text);
    }
    report
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{FleetDevice, FleetEdge, FleetWorker};

    #[test]
    fn the_last_report_is_kept_and_none_is_made_up() {
        let view = FleetView::default();
        assert_eq!(view.get(), None);
        for backlog in [3, 7] {
            view.set(FleetReport {
                backlog,
                ..FleetReport::default()
            });
        }
        assert_eq!(view.get().map(|report| report.backlog), Some(7));
    }

    /// A terminal's escape, a line break and a text of a megabyte, wherever another machine can put a text.
    #[test]
    fn no_text_of_another_machine_is_passed_on_as_it_is() {
        let bad = || format!("\u{1b}[2J\n{}", "x".repeat(1 << 20));
        let report = made_printable(FleetReport {
            server: bad(),
            edge: bad(),
            why: bad(),
            workers: vec![FleetWorker {
                name: bad(),
                version: bad(),
                ..FleetWorker::default()
            }],
            edges: vec![FleetEdge {
                name: bad(),
                version: bad(),
                ..FleetEdge::default()
            }],
            devices: vec![FleetDevice {
                name: bad(),
                edge: bad(),
                state: bad(),
                pot: bad(),
                build: bad(),
                ..FleetDevice::default()
            }],
            ..FleetReport::default()
        });
        let json = serde_json::to_value(&report).expect("a report is JSON");
        let mut texts = 0;
        let mut left = vec![json];
        while let Some(value) = left.pop() {
            match value {
                serde_json::Value::String(text) => {
                    assert!(text.chars().all(|c| !c.is_control()), "{text:.40}");
                    assert!(text.len() < 1_000, "{} bytes", text.len());
                    texts += 1;
                }
                serde_json::Value::Array(all) => left.extend(all),
                serde_json::Value::Object(all) => left.extend(all.into_iter().map(|(_, v)| v)),
                _ => {}
            }
        }
        assert_eq!(texts, 12);
    }
}
