//! Debug probes (ST-LINK, CMSIS-DAP and J-Link) through probe-rs.

mod attached;
mod connection;
mod errors;
mod flashing;
mod option_registers;
mod registers;
mod rtt;
mod running_target;

use std::rc::Rc;

use probe_rs::config::Registry;
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem};
use probe_rs::probe::{DebugProbeSelector, Probe, WireProtocol};
use probe_rs::{Permissions, Session};
use serde::Serialize;

use self::running_target::RunningTarget;

pub use attached::ProbeProgrammer;
pub use rtt::RttSource;

use crate::programmer::{FlashStep, ProgramError};

/// Description of the chip's family, cut from probe-rs's, which has 5 MB for all chips.
const TARGET: &str = include_str!("../../targets/STM32G474.yaml");

/// Name of the chip there; used for every package.
const CHIP: &str = "STM32G474RE";

/// Connected probe.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ProbeInfo {
    /// Name.
    pub name: String,
    /// USB vendor id.
    pub vendor_id: u16,
    /// USB product id.
    pub product_id: u16,
    /// Serial number; `None` if it has none.
    pub serial: Option<String>,
    /// Selector for `--probe`: `0483:374e:0042…`.
    pub selector: String,
    /// `true` if this user may open it.
    pub accessible: bool,
}

impl ProbeInfo {
    fn from_item(item: &ProbeListItem) -> Self {
        let info = &item.info;
        let serial = info.serial_number.clone();
        let mut selector = format!("{:04x}:{:04x}", info.vendor_id, info.product_id);
        if let Some(serial) = &serial {
            selector = format!("{selector}:{serial}");
        }
        Self {
            name: info.identifier.clone(),
            vendor_id: info.vendor_id,
            product_id: info.product_id,
            serial,
            selector,
            accessible: item.accessibility == Accessibility::Accessible,
        }
    }

    /// Name and selector.
    pub fn describe(&self) -> String {
        format!("{} ({})", self.name, self.selector)
    }
}

/// Probes of this machine, or of a test.
#[derive(Clone, Debug)]
pub struct Probes {
    lister: Rc<Lister>,
}

impl Default for Probes {
    /// Probes of this machine.
    fn default() -> Self {
        Self::with(Lister::new())
    }
}

impl Probes {
    /// Probes of a lister.
    pub fn with(lister: Lister) -> Self {
        Self {
            lister: Rc::new(lister),
        }
    }

    /// Lists the connected probes.
    pub fn list(&self) -> Vec<ProbeInfo> {
        let probes = self.lister.list_all_with_access();
        probes.iter().map(ProbeInfo::from_item).collect()
    }

    /// Connects to the chip behind a probe. Neither this nor reading resets or halts the chip.
    ///
    /// # Errors
    /// [`ProgramError::NotFound`], [`ProgramError::Several`] without a selector (`VID:PID` or `VID:PID:SERIAL`),
    /// [`ProgramError::Open`], [`ProgramError::NoChip`].
    pub fn attach(&self, selector: Option<&str>) -> Result<ProbeProgrammer, ProgramError> {
        let info = self.choose(selector)?;
        let target = self.attach_running(&info)?;
        Ok(ProbeProgrammer::new(self.clone(), info, target))
    }

    /// Opens the log behind a probe: from the block at an address, if the image names it (`_SEGGER_RTT`); otherwise RAM is searched
    /// for it. The chip is not reset, and may be absent at first.
    ///
    /// # Errors
    /// Any error of [`Probes::attach`] that concerns the probe.
    pub fn log(
        &self,
        selector: Option<&str>,
        block: Option<u32>,
    ) -> Result<RttSource, ProgramError> {
        let info = self.choose(selector)?;
        Ok(RttSource::new(self.clone(), info, block))
    }

    fn choose(&self, selector: Option<&str>) -> Result<ProbeInfo, ProgramError> {
        let parsed = selector.map(|text| {
            text.parse::<DebugProbeSelector>()
                .map_err(|why| not_found(format!("`{text}` names no probe ({why}); it is VID:PID or VID:PID:SERIAL, as `ihd doctor` lists them")))
        });
        let parsed = parsed.transpose()?;
        let items = self.lister.list_with_access(parsed.as_ref());
        let item = match items.as_slice() {
            [item] => item,
            [] => return Err(not_found(none_found(selector))),
            several => {
                return Err(ProgramError::Several {
                    choices: several
                        .iter()
                        .map(|item| ProbeInfo::from_item(item).describe())
                        .collect(),
                    option: "--probe VID:PID:SERIAL",
                });
            }
        };
        Ok(ProbeInfo::from_item(item))
    }

    /// Opens a probe, on whatever port it is now.
    fn open(&self, info: &ProbeInfo) -> Result<Probe, ProgramError> {
        let items = self.lister.list_all_with_access();
        let item = items
            .iter()
            .find(|item| ProbeInfo::from_item(item) == *info);
        let item = item.ok_or_else(|| not_found(none_found(Some(&info.selector))))?;
        let probe = self.lister.open(&item.info);
        let mut probe = probe.map_err(|why| ProgramError::Open {
            what: info.describe(),
            why: errors::chain(&why),
        })?;
        // Some probes have one protocol only.
        let _ = probe.select_protocol(WireProtocol::Swd);
        Ok(probe)
    }

    /// Connects without touching the core.
    fn attach_running(&self, info: &ProbeInfo) -> Result<RunningTarget, ProgramError> {
        let probe = self.open(info)?;
        RunningTarget::connect(probe).map_err(|why| errors::attaching(info, &why))
    }

    /// Connects for flashing: the core is halted at times.
    fn session(&self, info: &ProbeInfo) -> Result<Session, ProgramError> {
        let (probe, registry) = (self.open(info)?, registry()?);
        let session = probe.attach_with_registry(CHIP, Permissions::new(), &registry);
        session.map_err(|why| errors::attaching(info, &why))
    }
}

fn not_found(what: String) -> ProgramError {
    ProgramError::NotFound { what }
}

fn none_found(selector: Option<&str>) -> String {
    match selector {
        Some(selector) => format!(
            "no probe {selector} is plugged in; without --probe the only one is taken, and `ihd doctor` lists them"
        ),
        None => "no debug probe is plugged in: connect the board's ST-LINK socket (a NUCLEO has one on board), or an ST-LINK, \
                 a CMSIS-DAP or a J-Link. Without one the chip's own USB serves: `ihd flash --dfu`, `ihd log usb`. `ihd doctor` looks closer"
            .into(),
    }
}

fn registry() -> Result<Registry, ProgramError> {
    let mut registry = Registry::new();
    let added = registry.add_target_family_from_yaml(TARGET);
    added.map(|_| registry).map_err(|why| ProgramError::Probe {
        doing: FlashStep::Attaching,
        why: errors::chain(&why),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_family_is_this_one_chip() {
        let registry = registry().unwrap();
        let target = registry.get_target_by_name(CHIP).unwrap();
        assert_eq!(target.flash_algorithms.len(), 1);
        let flash = &target.flash_algorithms[0].flash_properties;
        assert_eq!(flash.address_range, 0x0800_0000..0x0808_0000);
        assert_eq!(
            flash.sectors[0].size,
            u64::from(ihd_shared::image::PAGE_BYTES)
        );
    }

    #[test]
    fn what_names_no_probe_is_told() {
        let why = Probes::default().attach(Some("yellow")).unwrap_err();
        assert!(why.to_string().contains("VID:PID"), "{why}");
    }
}
