//! Commands to a device, one method each.

use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{
    ClearFault, Configure, GetStatus, GetUtilisation, PushLookup, Raw, ReadLookup, Reply,
    ResetLookup, SetPower, Status, Stream, Utilisation,
};

use super::Client;
use crate::LinkError;
use crate::granted_power::GrantedPower;

impl Client {
    /// Requests a mean power in watt; 0 switches off. Returns what the device took: at most its rating.
    ///
    /// # Errors
    /// [`LinkError::Refused`] while a fault is active, or above
    /// [`REQUESTED_POWER_MAX_W`](ihd_shared::hob::REQUESTED_POWER_MAX_W), else any error of [`Client::request`].
    pub fn set_power(&mut self, power_w: u16) -> Result<GrantedPower, LinkError> {
        let reply: Reply = self.request(&SetPower { power_w })?;
        Ok(GrantedPower::from_detail(power_w, reply.detail))
    }

    /// Switches off; this command is never preempted.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn off(&mut self) -> Result<(), LinkError> {
        self.off_preemption.runs_off = true;
        let off = self.set_power(0);
        self.off_preemption.runs_off = false;
        off.map(drop)
    }

    /// Requests telemetry and a window every so many half-cycles; 0 for none.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn stream(&mut self, telemetry_every: u8, windows_every: u8) -> Result<(), LinkError> {
        let stream = Stream {
            telemetry_every,
            windows_every,
        };
        self.order(&stream)
    }

    /// Reads the state of the controller.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn status(&mut self) -> Result<Status, LinkError> {
        self.request(&GetStatus {})
    }

    /// Reads the controller's processor load since the last call.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn utilisation(&mut self) -> Result<Utilisation, LinkError> {
        self.request(&GetUtilisation {})
    }

    /// Sends a lookup. If accepted, it becomes active at the next half-cycle boundary, which [`Client::status`] shows; if refused,
    /// the device keeps its own.
    ///
    /// # Errors
    /// [`LinkError::Refused`] with the device's reason, else any error of [`Client::request`].
    pub fn push_lookup(&mut self, lookup: &RlLookup) -> Result<(), LinkError> {
        self.push_lookup_bytes(&lookup.to_bytes())
    }

    /// Sends arbitrary bytes as a lookup; the device checks them.
    ///
    /// # Errors
    /// Any error of [`Client::push_lookup`]; [`LinkError::Unsendable`] for more bytes than a frame holds.
    pub fn push_lookup_bytes(&mut self, blob: &[u8]) -> Result<(), LinkError> {
        self.order(&PushLookup { blob: Raw(blob) })
    }

    /// Reads the active lookup.
    ///
    /// # Errors
    /// [`LinkError::DamagedLookup`] when it fails the checks, else any error of [`Client::request`].
    pub fn read_lookup(&mut self) -> Result<RlLookup, LinkError> {
        let device = self.describe();
        let read = self.request(&ReadLookup {})?;
        RlLookup::from_bytes(read.blob.0)
            .map_err(|source| LinkError::DamagedLookup { device, source })
    }

    /// Restores the built-in lookup, version 0, at the next half-cycle boundary.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn reset_lookup(&mut self) -> Result<(), LinkError> {
        self.order(&ResetLookup {})
    }

    /// Changes the device's settings until its next boot.
    ///
    /// # Errors
    /// [`LinkError::Refused`] when one is outside its range, else any error of [`Client::request`].
    pub fn configure(&mut self, settings: &Configure) -> Result<(), LinkError> {
        self.order(settings)
    }

    /// Leaves the safe state after a fault; power must be requested again.
    ///
    /// # Errors
    /// Any error of [`Client::request`].
    pub fn clear_fault(&mut self) -> Result<(), LinkError> {
        self.order(&ClearFault {})
    }
}
