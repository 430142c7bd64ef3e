//! Board of a simulated hob: its comparator, its reference voltage, and its services to the firmware's link.

use ihd_firmware::link::channel_test::SlowCodes;
use ihd_firmware::link::service::BoardServices;
use ihd_firmware::sense::codes::TRIP_CODE;
use ihd_firmware::sense::supply::{Reference, SupplyScale};
use ihd_shared::sampling::AMPERE_PER_CODE;
use ihd_shared::wire::messages::Program;

use crate::front_end::REFERENCE_CALIBRATION;
use crate::injection::{InjectionKind, Injections};

/// Coil current at which the comparator opens the bridge, in ampere: its threshold is a share of the supply.
pub(super) fn comparator_a(scale: SupplyScale, injections: &Injections) -> f64 {
    if injections.has(InjectionKind::ComparatorDead) {
        return f64::INFINITY;
    }
    let supply = injections.product(InjectionKind::Supply);
    f64::from(scale.dac_code(TRIP_CODE)) * AMPERE_PER_CODE * supply
}

/// Reading of the chip's reference voltage.
pub(super) fn reference(injections: &Injections) -> Reference {
    let supply_v = injections.supply_v();
    let ratio = injections.product(InjectionKind::Reference);
    let code =
        f64::from(REFERENCE_CALIBRATION) * f64::from(Reference::CALIBRATED_MV) * 1e-3 / supply_v;
    Reference {
        code: (code * ratio).round() as u16,
        calibrated: REFERENCE_CALIBRATION,
    }
}

/// Services of a simulated board: converters, and a program that can restart.
pub(super) struct SimulatedBoard {
    pub(super) slow: SlowCodes,
    pub(super) reference: Reference,
    pub(super) restarts: bool,
}

impl BoardServices for SimulatedBoard {
    fn has_program(&self, into: Program) -> bool {
        into == Program::Firmware
    }
    fn restart(&mut self, _: Program) {
        self.restarts = true;
    }
    fn slow_codes(&mut self) -> Option<SlowCodes> {
        Some(self.slow)
    }
    fn reference(&mut self) -> Option<Reference> {
        Some(self.reference)
    }
}
