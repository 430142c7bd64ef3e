//! Route of a window: to the store, and from there to the learner unless the fleet learns from it.

use std::sync::Arc;

use ihd_link::Window;
use ihd_model::{EventKind, RecordKind};
use ihd_signal::truth::Truth;
use ihd_store::{CurveSource, DeviceId, InsertOutcome, SessionId, Store, StoreError};

use super::session::{DeviceSession, StoredIds};
use crate::config::is_name;
use crate::device_record::DeviceRecord;
use crate::fleet::delegation::Delegation;
use crate::learning::{LearnInput, LearnJob, Learner, truth_curve};
use crate::window_accounting::{Arrival, WindowCounter};

/// Window with what is known about its half-cycle.
struct ArrivedWindow {
    window: Box<Window>,
    /// `true` if the hob heated, or if that is unknown.
    is_learnable: bool,
    /// Power of the half-cycle in watt; `None` if unknown.
    power_w: Option<f64>,
    /// True R and L; `None` unless the device is simulated in this process.
    truth: Option<Truth>,
}

/// Route of the windows of one session.
struct WindowRoute {
    record: Arc<DeviceRecord>,
    learner: Arc<Learner>,
    delegation: Arc<Delegation>,
    device_id: DeviceId,
    session: SessionId,
    boot: u32,
}

impl WindowRoute {
    /// Stores a window, then passes it on to the learner, or leaves it to the fleet.
    ///
    /// # Errors
    /// Error of the store.
    fn follow(self, store: &mut Store, arrived: ArrivedWindow) -> Result<(), StoreError> {
        let ArrivedWindow {
            window,
            is_learnable,
            power_w,
            truth,
        } = arrived;
        // The fleet knows hobs by names of the configuration; a board that was plugged in has none.
        let for_fleet = is_learnable && self.delegation.is_edge && is_name(&self.record.name);
        let stored = store.keep_window_for(self.session, &window, for_fleet);
        self.count(match &stored {
            Ok((InsertOutcome::New, _)) => WindowCounter::Stored,
            Ok((InsertOutcome::Known, _)) | Err(_) => WindowCounter::NotStored,
        });
        let (outcome, is_due) = stored?;
        if outcome == InsertOutcome::Known {
            // Another window of a boot with the same number: what was learned from the stored one stays.
            return Ok(());
        }
        let (boot, seq) = (self.boot, window.seq);
        if let Some(truth) = &truth {
            let curve = truth_curve(truth, &window);
            store.keep_curve(self.session, seq, CurveSource::Truth, &curve)?;
        }
        // Last: a subscriber reads the window with its truth.
        self.record.publish(EventKind::WindowStored { boot, seq });
        if !is_learnable {
            self.count(WindowCounter::Unfit);
        } else if !(is_due && self.delegation.is_delegated_of(&self.record.name)) {
            // The learner counts the window that it drops for this one.
            self.learner.offer(LearnJob {
                device: self.record.name.clone(),
                device_id: self.device_id,
                session: self.session,
                boot,
                input: LearnInput::Window(window),
                power_w,
                truth,
                stored: None,
            });
        }
        Ok(())
    }

    fn count(&self, counter: WindowCounter) {
        self.record.lock().windows.count(counter);
    }
}

impl DeviceSession<'_> {
    /// Sends a window on its route.
    pub(super) fn on_window(&mut self, window: Box<Window>) {
        // If a fit has locked the tracker, the next window sets the same value.
        if let Some(mut tracker) = self.record.try_pot_tracker() {
            tracker.set_half_cycle(1e-9 * f64::from(window.half_cycle_ns));
        }
        if let Some(sweep) = self.active_sweep() {
            sweep.window(window.half_cycle);
        }
        if self.record.lock().windows.arrived(window.seq) == Arrival::Duplicate {
            return;
        }
        let route = self.window_route();
        if route.is_none() {
            // A window's row refers to the session's, which is not stored.
            self.context.store.count_dropped(RecordKind::Windows, 1);
        }
        let is_queued = match route.filter(|_| self.flood.windows.allow()) {
            Some(route) => {
                let arrived = self.arrived_window(window);
                let store = self.store().writing_once(RecordKind::Windows);
                store.offer(move |store| route.follow(store, arrived))
            }
            None => false,
        };
        if !is_queued {
            let mut inner = self.record.lock();
            inner.windows.count(WindowCounter::NotStored);
        }
    }

    /// Returns the route of a window; `None` if the session is not stored.
    fn window_route(&self) -> Option<WindowRoute> {
        let StoredIds { device, session } = self.stored?;
        Some(WindowRoute {
            record: Arc::clone(self.record),
            learner: Arc::clone(&self.context.learner),
            delegation: Arc::clone(&self.context.delegation),
            device_id: device,
            session,
            boot: self.link.client.hello().boot_id,
        })
    }

    /// Adds to a window what is known about its half-cycle.
    fn arrived_window(&self, window: Box<Window>) -> ArrivedWindow {
        let half_cycle = window.half_cycle;
        let telemetry = self.recent_powers.iter().find(|(at, ..)| *at == half_cycle);
        ArrivedWindow {
            window,
            is_learnable: telemetry.is_none_or(|(_, is_heating, _)| *is_heating),
            power_w: telemetry.map(|(_, _, power_mw)| f64::from(*power_mw) * 1e-3),
            truth: self.truth.as_ref().and_then(|truth| truth(half_cycle)),
        }
    }
}
