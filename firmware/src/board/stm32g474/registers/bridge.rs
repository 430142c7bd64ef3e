//! HRTIM: the timer of the half-bridge and the one of the ADCs.

use embassy_stm32::pac;
use embassy_stm32::pac::hrtim::vals::Fault as FaultState;
use ihd_firmware::drive::pwm::{DEAD_TIME_NS, Periods};
use ihd_shared::sampling::{ADC_LOCK_P, ADC_LOCK_Q};

use super::clocks::CORE_MHZ;
use super::{BRIDGE, SAMPLING, faults, sampling_watchdog};

/// HRTIM prescaler 2 (table "HRTIM resolution and min. PWM frequency" in HRTIM): 8 ticks a cycle.
const PRESCALER: u8 = 2;

/// Dead time in steps of one cycle (HRTIM, HRTIM_DTxR: DTPRSC = 3), of which 9 bits hold 3 µs.
const DEAD_TIME_STEPS: u16 = (DEAD_TIME_NS * CORE_MHZ).div_ceil(1_000) as u16;
const _: () = assert!(DEAD_TIME_STEPS > 0 && DEAD_TIME_STEPS < 512);

/// Least value of a compare register (HRTIM, "Timer period and compare min and max values"), in ticks: 70 ns.
const TRIGGER_TICKS: u16 = 0x60;

/// Value of TIMxREP: one less than the periods between two repetition events. 61 of the sampling timer
/// are as long as 3 of the bridge's, so both timers' come at the same tick, for ever.
const REPETITION: [(usize, u8); 2] = [
    (BRIDGE, ADC_LOCK_Q as u8 - 1),
    (SAMPLING, ADC_LOCK_P as u8 - 1),
];

/// HRTIM, HRTIM_ODISR: both switches open, at once: the outputs take their idle state, which is low.
#[inline(always)]
pub fn open() {
    pac::HRTIM1.odisr().write(|w| {
        w.set_t1odis(BRIDGE, true);
        w.set_t2odis(BRIDGE, true);
    });
    switch(false);
}

/// The lower switch closed, the upper one open, out of both open: HRTIM_OENR, after HRTIM_ICR has
/// cleared what tripped before. Output 2 is output 1's complement, and nothing sets output 1.
pub fn close_lower() {
    faults::clear();
    pac::HRTIM1.oenr().write(|w| {
        w.set_t1oen(BRIDGE, true);
        w.set_t2oen(BRIDGE, true);
    });
}

/// HRTIM_SETA1R: sets output 1 at the period, so that both switches close in turn, or no longer; from the
/// next repetition event on, with a whole period. The way there inserts dead time like any other edge.
/// Outputs that have tripped meanwhile are not enabled again.
#[inline(always)]
pub fn switch(on: bool) {
    let bridge = pac::HRTIM1.tim(BRIDGE);
    bridge.setr(0).write(|w| w.set_per(on));
}

/// HRTIM, "HRTIM initialization": DLL, both timers, outputs, faults. HRTIM is clocked and reset
/// already; the bridge stays off, and the counters stand still until [`run_timers`].
pub fn prepare_timers(periods: Periods) {
    let hrtim = pac::HRTIM1;
    calibrate();
    for (timer, repetition) in REPETITION {
        // HRTIM_TIMxCR: continuous, preloaded, updated at the repetition event.
        hrtim.tim(timer).cr().write(|w| {
            w.set_ckpsc(PRESCALER);
            w.set_cont(true);
            w.set_preen(true);
            w.set_repu(true);
        });
        hrtim.tim(timer).rep().write(|w| w.set_rep(repetition));
    }
    let bridge = hrtim.tim(BRIDGE);
    // HRTIM_DTAR.
    bridge.dt().write(|w| {
        w.set_dtprsc(3);
        w.set_dtr(DEAD_TIME_STEPS);
        w.set_dtf(DEAD_TIME_STEPS);
    });
    // HRTIM_RSTA1R: output 1 off at compare 1; `switch` sets it. Output 2 is its complement.
    bridge.setr(0).write(|_| {});
    bridge.rstr(0).write(|w| w.set_cmp(0, true));
    // HRTIM_OUTAR: idle and fault states low.
    bridge.outr().write(|w| {
        w.set_dten(true);
        for output in 0..2 {
            w.set_fault(output, FaultState::SET_INACTIVE);
        }
    });
    preload(periods, periods.half());
    // HRTIM_CMP3BR.
    hrtim
        .tim(SAMPLING)
        .cmp(2)
        .write(|w| w.set_cmp(TRIGGER_TICKS));
    // HRTIM_CR2: from preload to active, now; the timers stand still.
    hrtim.cr2().write(|w| {
        w.set_tswu(BRIDGE, true);
        w.set_tswu(SAMPLING, true);
    });
    // Only now: HRTIM_DTAR is preloaded (HRTIM, table "HRTIM preloadable control registers"), and what is
    // locked is what is in force. Both dead times and their signs until reset.
    bridge.dt().modify(|w| {
        w.set_dtrlk(true);
        w.set_dtflk(true);
        w.set_dtrslk(true);
        w.set_dtfslk(true);
    });
    sampling_watchdog::start();
    faults::start();
    // HRTIM_ADC1R: trigger 1 at the begin of the sampling timer's period. Its end would be a pair later than the soft limits
    // take the one behind a turn-off for.
    hrtim.adc1r(0).write(|w| w.set_adctc3(SAMPLING, true));
}

/// HRTIM_MCR: both counters in one write, once the ADCs wait for their triggers: then the first pair of a
/// block is taken at the repetition event, and new periods begin with a block.
pub fn run_timers() {
    pac::HRTIM1.mcr().modify(|w| {
        w.set_tcen(BRIDGE, true);
        w.set_tcen(SAMPLING, true);
    });
}

/// HRTIM_DLLCR: calibrate once, then every 2 048 cycles, 12 µs (CALRTE = 3; ST's
/// `LL_HRTIM_DLLCALIBRATION_RATE_3`).
fn calibrate() {
    let hrtim = pac::HRTIM1;
    hrtim.dllcr().write(|w| w.set_cal(true));
    while !hrtim.isr().read().dllrdy() {}
    hrtim.dllcr().write(|w| {
        w.set_calen(true);
        w.set_calrte(3);
    });
}

/// New periods for both timers, the upper switch on until `on`, at the same tick, at the end of a block: when both timers' repetition
/// events come (HRTIM, "Repetition", TIMxCR.TxREPU). No counter is reset, so no switch stays closed
/// longer than half an old or half a new period, and the lock of the two stays exact.
///
/// HRTIM_CR1, TxUDIS: neither timer updates while only some of the registers are written.
pub fn set_periods(periods: Periods, on: u16) {
    let hrtim = pac::HRTIM1;
    hrtim.cr1().write(|w| {
        w.set_tudis(BRIDGE, true);
        w.set_tudis(SAMPLING, true);
    });
    preload(periods, on);
    hrtim.cr1().write(|_| {});
}

/// HRTIM_PERxR, HRTIM_CMP1xR; `on` is the end of the upper switch's part of the period, in ticks.
fn preload(periods: Periods, on: u16) {
    let hrtim = pac::HRTIM1;
    let bridge = hrtim.tim(BRIDGE);
    bridge.per().write(|w| w.set_per(periods.switching));
    bridge.cmp(0).write(|w| w.set_cmp(on));
    let sampling = hrtim.tim(SAMPLING);
    sampling.per().write(|w| w.set_per(periods.sampling));
}
