//! The trip in hardware: DAC1 holds the threshold on COMP1 and COMP2, which see the coil current and its
//! inverse. [`super::faults`] leads them to the bridge.

use embassy_stm32::pac;
use embassy_stm32::pac::comp::vals::{Hysteresis, Inm, Polarity};
use embassy_stm32::pac::dac::vals::Mode;
use embassy_stm32::{peripherals, rcc};
use ihd_firmware::sense::codes::TRIP_CODE;
use ihd_firmware::sense::supply::SupplyScale;
use ihd_shared::wire::messages::Comparators;

use super::clocks::CORE_MHZ;
use super::faults;

/// The sensor's zero is at mid-scale. Codes are the ADC's, so the hardware trips where the software
/// does, a block earlier.
const fn level(code: u16) -> u16 {
    2_048 + code
}

/// HFSEL for an AHB above 160 MHz (DAC, DAC_MCR). The reason why embassy's driver is not used: it takes
/// the frequency from its table ([`super::clocks`]).
const ABOVE_160_MHZ: u8 = 2;

/// DAC, DAC_MCR before DAC_CR: connected to on-chip peripherals alone, without buffer; value after EN, as ST's
/// HAL_DAC_Start and HAL_DAC_SetValue. Then t_WAKEUP, 7.5 µs at most (DS12288, DAC characteristics; ST's `LL_DAC_DELAY_STARTUP_VOLTAGE_SETTLING_US` is 8).
fn start_thresholds() {
    rcc::enable_and_reset::<peripherals::DAC1>();
    pac::DAC1.mcr().write(|w| {
        w.set_hfsel(ABOVE_160_MHZ);
        for channel in 0..2 {
            w.set_mode(channel, Mode::NORMAL_INT_BUFDIS);
        }
    });
    pac::DAC1.cr().write(|w| {
        w.set_en(0, true);
        w.set_en(1, true);
    });
    for channel in 0..2 {
        pac::DAC1
            .dhr12r(channel)
            .write(|w| w.set_dhr(level(TRIP_CODE)));
    }
    cortex_m::asm::delay(8 * CORE_MHZ);
}

/// COMP, COMP_CxCSR: the current's two polarities against their DAC1 thresholds (table "COMPx
/// inverting input assignment": DAC1_CH1 for COMP1, DAC1_CH2 for COMP2), once those have settled; then
/// locked until reset.
pub fn start() {
    start_thresholds();
    for comparator in [pac::COMP1, pac::COMP2] {
        comparator.csr().write(|w| {
            // Input 0 is PA1 for COMP1 and PA7 for COMP2 (table "COMPx non-inverting input").
            w.set_inpsel(false);
            w.set_inmsel(Inm::DACB);
            w.set_polarity(Polarity::NOT_INVERTED);
            w.set_hyst(Hysteresis::HYST20M);
            w.set_en(true);
        });
    }
    // t_START is 5 µs at most (DS12288, comparator characteristics).
    cortex_m::asm::delay(5 * CORE_MHZ);
    for comparator in [pac::COMP1, pac::COMP2] {
        comparator.csr().modify(|w| w.set_lock(true));
    }
}

/// Tests the trip, from the threshold to HRTIM's fault inputs: with both at 0 V both comparators must trip, as the
/// current's zero is at mid-scale, and with both back where they belong none may. To be called once the fault inputs are
/// armed, with the bridge open; it stays so, as an output is enabled by software alone.
pub fn trip() -> Comparators {
    let threshold = pac::DAC1.dhr12r(0).read().dhr();
    set_thresholds(0);
    let [negative_tripped, positive_tripped] = faults::comparators_tripped();
    set_thresholds(threshold);
    faults::clear();
    cortex_m::asm::delay(2 * CORE_MHZ);
    let [negative, positive] = faults::comparators_tripped();
    Comparators {
        positive_tripped,
        positive_quiet: !positive,
        negative_tripped,
        negative_quiet: !negative,
    }
}

/// Keeps both thresholds at the trip's current whatever the supply: the DAC's codes are shares of it.
pub fn correct(scale: SupplyScale) {
    let code = level(scale.dac_code(TRIP_CODE));
    for channel in 0..2 {
        pac::DAC1.dhr12r(channel).write(|w| w.set_dhr(code));
    }
}

/// DAC, DAC_DHR12Rx; then the DAC settles (t_SETTLING 3 µs at most without buffer, DS12288), the comparator follows and
/// HRTIM's filter (330 ns) passes it on.
fn set_thresholds(code: u16) {
    for channel in 0..2 {
        pac::DAC1.dhr12r(channel).write(|w| w.set_dhr(code));
    }
    cortex_m::asm::delay(10 * CORE_MHZ);
}
