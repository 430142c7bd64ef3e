//! The debug port as a probe of probe-rs, and a list of such probes.

use std::fmt;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use probe_rs::CoreStatus;
use probe_rs::architecture::arm::sequences::ArmDebugSequence;
use probe_rs::architecture::arm::{
    ArmCommunicationInterface, ArmDebugInterface, ArmError, DapError, DapProbe, RawDapAccess,
    RegisterAddress,
};
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem, ProbeLister};
use probe_rs::probe::{
    DebugProbe, DebugProbeError, DebugProbeInfo, DebugProbeSelector, Probe, ProbeCreationError,
    ProbeFactory, WireProtocol,
};

use crate::port::{DebugPort, Refusal};
use crate::target::{Contact, Target};

/// USB ids of the probe: those for tests.
const USB_ID: (u16, u16) = (0x1209, 0x0001);

/// A target on a desk, which a test holds as well as the probe.
#[derive(Debug)]
pub struct Desk<T>(Arc<Mutex<DebugPort<T>>>);

impl<T> Clone for Desk<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<T: Target + fmt::Debug + 'static> Desk<T> {
    /// With a probe plugged in.
    pub fn new(target: T) -> Self {
        Self(Arc::new(Mutex::new(DebugPort::new(target))))
    }

    fn port(&self) -> MutexGuard<'_, DebugPort<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at the target, or does something to it.
    pub fn with<R>(&self, look: impl FnOnce(&mut T) -> R) -> R {
        look(&mut self.port().core.target)
    }

    /// Presses the reset button.
    pub fn reset_button(&self) {
        self.port().reset_pin();
    }

    /// A list of probe-rs with this one probe.
    pub fn lister(&self) -> Lister {
        Self::list(&[(self, "MODEL1")])
    }

    /// A list with several, by serial number.
    pub fn list(desks: &[(&Self, &'static str)]) -> Lister {
        let desks = desks
            .iter()
            .map(|(desk, serial)| ((*desk).clone(), *serial));
        Lister::with_lister(Box::new(Desks(desks.collect())))
    }
}

#[derive(Debug)]
struct Desks<T>(Vec<(Desk<T>, &'static str)>);

/// probe-rs wants one for each entry of a list; nothing is opened through it.
#[derive(Debug)]
struct Factory;

impl fmt::Display for Factory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("model")
    }
}

impl ProbeFactory for Factory {
    fn open(&self, _: &DebugProbeSelector) -> Result<Box<dyn DebugProbe>, DebugProbeError> {
        Err(ProbeCreationError::NotFound.into())
    }

    fn list_probes(&self) -> Vec<ProbeListItem> {
        Vec::new()
    }
}

fn info(serial: &str) -> DebugProbeInfo {
    let (vendor, product) = USB_ID;
    let serial = Some(serial.to_owned());
    DebugProbeInfo::new(
        "Model probe",
        vendor,
        product,
        serial,
        &Factory,
        None,
        false,
    )
}

impl<T: Target + fmt::Debug + 'static> ProbeLister for Desks<T> {
    fn open(&self, selector: &DebugProbeSelector) -> Result<Probe, DebugProbeError> {
        let found = self
            .0
            .iter()
            .find(|(_, serial)| selector.matches_probe(&info(serial)));
        match found {
            Some((desk, _)) if desk.port().core.target.contact() != Contact::NoProbe => {
                Ok(Probe::new(ModelProbe { desk: desk.clone() }))
            }
            _ => Err(ProbeCreationError::NotFound.into()),
        }
    }

    fn list_with_access(&self, selector: Option<&DebugProbeSelector>) -> Vec<ProbeListItem> {
        let plugged = self
            .0
            .iter()
            .filter(|(desk, _)| desk.port().core.target.contact() != Contact::NoProbe);
        let infos = plugged.map(|(_, serial)| info(serial));
        let wanted = infos.filter(|info| selector.is_none_or(|wanted| wanted.matches_probe(info)));
        wanted
            .map(|info| ProbeListItem {
                info,
                accessibility: Accessibility::Accessible,
            })
            .collect()
    }
}

/// The probe.
struct ModelProbe<T> {
    desk: Desk<T>,
}

impl<T> fmt::Debug for ModelProbe<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("ModelProbe")
    }
}

fn unplugged() -> DebugProbeError {
    DebugProbeError::Usb(io::Error::new(
        io::ErrorKind::NotConnected,
        "device disconnected",
    ))
}

impl<T: Target + fmt::Debug + 'static> ModelProbe<T> {
    /// An access, and what a probe's firmware does after a FAULT: it clears the sticky error.
    fn access<R>(
        &mut self,
        access: impl FnOnce(&mut DebugPort<T>) -> Result<R, Refusal>,
    ) -> Result<R, ArmError> {
        let mut port = self.desk.port();
        access(&mut port).map_err(|refusal| match refusal {
            Refusal::Fault => {
                let _ = port.write_dp(0x0, 1 << 2);
                ArmError::Dap(DapError::FaultResponse)
            }
            Refusal::NoAnswer => ArmError::Dap(DapError::NoAcknowledge),
            Refusal::NoProbe => ArmError::Probe(unplugged()),
        })
    }

    fn plugged(&self) -> Result<(), DebugProbeError> {
        match self.desk.port().core.target.contact() {
            Contact::NoProbe => Err(unplugged()),
            _ => Ok(()),
        }
    }
}

impl<T: Target + fmt::Debug + 'static> DebugProbe for ModelProbe<T> {
    fn get_name(&self) -> &str {
        "Model probe"
    }

    fn speed_khz(&self) -> u32 {
        4_000
    }

    fn set_speed(&mut self, speed_khz: u32) -> Result<u32, DebugProbeError> {
        Ok(speed_khz)
    }

    fn attach(&mut self) -> Result<(), DebugProbeError> {
        self.plugged()
    }

    fn detach(&mut self) -> Result<(), probe_rs::Error> {
        Ok(())
    }

    fn target_reset(&mut self) -> Result<(), DebugProbeError> {
        self.plugged()?;
        self.desk.port().reset_pin();
        Ok(())
    }

    fn target_reset_assert(&mut self) -> Result<(), DebugProbeError> {
        self.target_reset()
    }

    fn target_reset_deassert(&mut self) -> Result<(), DebugProbeError> {
        self.plugged()
    }

    fn select_protocol(&mut self, protocol: WireProtocol) -> Result<(), DebugProbeError> {
        match protocol {
            WireProtocol::Swd => Ok(()),
            WireProtocol::Jtag => Err(DebugProbeError::UnsupportedProtocol(protocol)),
        }
    }

    fn active_protocol(&self) -> Option<WireProtocol> {
        Some(WireProtocol::Swd)
    }

    fn has_arm_interface(&self) -> bool {
        true
    }

    fn try_get_arm_debug_interface<'probe>(
        self: Box<Self>,
        sequence: Arc<dyn ArmDebugSequence>,
    ) -> Result<Box<dyn ArmDebugInterface + 'probe>, (Box<dyn DebugProbe>, ArmError)> {
        Ok(ArmCommunicationInterface::create(self, sequence, false))
    }

    fn into_probe(self: Box<Self>) -> Box<dyn DebugProbe> {
        self
    }

    fn try_as_dap_probe(&mut self) -> Option<&mut dyn DapProbe> {
        Some(self)
    }
}

impl<T: Target + fmt::Debug + 'static> RawDapAccess for ModelProbe<T> {
    fn raw_read_register(&mut self, address: RegisterAddress) -> Result<u32, ArmError> {
        self.access(|port| match address {
            RegisterAddress::DpRegister(register) => port.read_dp(register.address),
            RegisterAddress::ApRegister(register) => port.read_ap(register),
        })
    }

    fn raw_write_register(&mut self, address: RegisterAddress, value: u32) -> Result<(), ArmError> {
        self.access(|port| match address {
            RegisterAddress::DpRegister(register) => port.write_dp(register.address, value),
            RegisterAddress::ApRegister(register) => port.write_ap(register, value),
        })
    }

    fn jtag_sequence(&mut self, _: u8, _: bool, _: u64) -> Result<(), DebugProbeError> {
        Err(DebugProbeError::UnsupportedProtocol(WireProtocol::Jtag))
    }

    fn swj_sequence(&mut self, _: u8, _: u64) -> Result<(), DebugProbeError> {
        self.plugged()
    }

    /// No pins can be read back.
    fn swj_pins(&mut self, _: u32, _: u32, _: u32) -> Result<u32, DebugProbeError> {
        self.plugged().map(|()| u32::MAX)
    }

    fn into_probe(self: Box<Self>) -> Box<dyn DebugProbe> {
        self
    }

    fn core_status_notification(&mut self, _: CoreStatus) -> Result<(), DebugProbeError> {
        Ok(())
    }
}

impl<T: Target + fmt::Debug + 'static> DapProbe for ModelProbe<T> {}
