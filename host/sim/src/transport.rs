//! The simulated hob as a device in this process. Simulated time passes only while the host waits
//! for bytes, so a run gives the same digits whatever else the machine does.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use ihd_link::{LinkError, Transport};
use ihd_signal::truth::Truth;

use super::hob::SimHob;

/// A hob that the host's transport and whoever asks for the truth share.
#[derive(Clone)]
pub struct SharedHob(Arc<Mutex<SimHob>>);

impl SharedHob {
    /// Shares a hob.
    pub fn new(hob: SimHob) -> Self {
        Self(Arc::new(Mutex::new(hob)))
    }

    /// The hob. A panic elsewhere leaves it usable: every step is complete in itself.
    pub fn lock(&self) -> MutexGuard<'_, SimHob> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SharedHob {
    /// The truth of one of the last half-cycles, counted as the firmware counts them.
    pub fn truth(&self, half_cycle: u32) -> Option<Truth> {
        self.lock().truth(half_cycle).cloned()
    }
}

impl Transport for SharedHob {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.lock().send(bytes);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let mut hob = self.lock();
        let deadline_s = hob.t_s() + timeout.as_secs_f64();
        loop {
            let n = hob.receive(buf);
            if n > 0 || hob.t_s() >= deadline_s {
                return Ok(n);
            }
            hob.step();
        }
    }

    fn clock(&self) -> Duration {
        Duration::from_secs_f64(self.lock().t_s())
    }

    fn describe(&self) -> String {
        "sim".to_owned()
    }
}
