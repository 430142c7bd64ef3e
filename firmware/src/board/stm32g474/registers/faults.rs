//! Faults that open the bridge without software, and the flags that they leave.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::pac;
use embassy_stm32::pac::hrtim::regs::HrtimIsr;
use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::sampling::path::SamplingPath;
use ihd_firmware::sense::product_sums::PairArithmetic;
use ihd_shared::fault::Fault;

use super::{BRIDGE, supply};

/// HRTIM's fault inputs that a comparator reaches: COMP2 on 1, COMP1 on 4 (HRTIM, table "HRTIM fault
/// inputs").
const COMPARATORS: [usize; 2] = [0, 3];

/// HRTIM's fault input that the sampling watchdog reaches: 2, from external event 2 (HRTIM, table "HRTIM fault inputs").
const SAMPLING_WATCHDOG: usize = 1;

/// HRTIM_FLTINR2, FLT2SRC[1]: external event 2 before its own edge detection (ST's `HRTIM_FAULTSOURCE_EEVINPUT`).
const FLT2SRC_1: u32 = 1 << 17;

/// HRTIM_FLTINR2, which the metapac has at FLTINR1's address.
fn fltinr2() -> *mut u32 {
    pac::HRTIM1.fltinr1().as_ptr().cast::<u32>().wrapping_add(1)
}

/// HRTIM, FLTxF = 8: six samples in a row, one every 8 cycles of 170 MHz (ST's `HRTIM_FAULTFILTER_8`, with
/// FLTSD = 0). What is shorter than 235 ns does not trip; what lasts trips within 330 ns.
///
/// Why a filter: each edge of the bridge moves 400 V within 100 ns; what that couples into the current
/// sensor rings for 200 ns, and the comparators cannot be blanked by HRTIM (COMP, COMP_CxCSR, BLANKSEL
/// names TIM1 to 20 alone). What it costs: at the most 400 V / 20 µH · 330 ns = 6.6 A above the trip.
const FILTER: u8 = 8;

/// Fault inputs that are armed.
const INPUTS: [usize; 3] = [COMPARATORS[0], SAMPLING_WATCHDOG, COMPARATORS[1]];

/// EXTI line of the supply's detector (EXTI, table "EXTI lines connections").
const PVD_LINE: usize = 16;

/// PWR_CR2, PVDLS: 2.9 V, the highest (ST's `PWR_PVDLEVEL_6`). 3.3 V ± 5 % stay above it. Below, the
/// current sensor and the reference of DAC and ADCs, which is the supply, no longer mean the same; and
/// the bridge opens long before the chip resets (BOR levels end at 2.8 V).
const PVD_LEVEL: u8 = 6;

/// Arms all of it; locked until reset.
pub fn start() {
    // DBGMCU_APB2FZR, DBG_HRTIM_STOP: a halt of the core by a debugger puts the outputs into FAULT state, where they stay (HRTIM,
    // "HRTIM output states and transitions"). The bit is 26: `hrtim0` in ST's SVD and here, HRTIM1 in ST's HAL.
    pac::DBGMCU.apb2fzr().modify(|w| w.set_hrtim0(true));
    start_inputs();
    start_supply_detector();
    // SYSCFG_CFGR2: lock-up, RAM parity, ECC and supply reach HRTIM's system fault. PVDL also locks
    // PVDE and PVDLS, so the detector is on by now.
    let parity = supply::has_parity();
    pac::SYSCFG.cfgr2().modify(|w| {
        w.set_cll(true);
        w.set_spl(parity);
        w.set_pvdl(true);
        w.set_eccl(true);
    });
}

/// HRTIM_FLTINR1: source, polarity and filter may change only while the input is off, so it is enabled by
/// a second write, and locked by a third (ST's `HAL_HRTIM_FaultConfig` before
/// `HAL_HRTIM_FaultModeCtl`). HRTIM_FLTAR: all three open the bridge.
fn start_inputs() {
    let hrtim = pac::HRTIM1;
    hrtim.fltinr1().modify(|w| {
        for input in COMPARATORS {
            w.set_fltsrc(input, true);
            w.set_fltp(input, true);
            w.set_fltf(input, FILTER);
        }
        // No filter: the timer's output rings on no wire.
        w.set_fltp(SAMPLING_WATCHDOG, true);
    });
    // SAFETY: a register of HRTIM (RM0440, 27.5.51), which only this function touches.
    unsafe { fltinr2().write_volatile(fltinr2().read_volatile() | FLT2SRC_1) };
    hrtim
        .fltinr1()
        .modify(|w| INPUTS.map(|input| w.set_flte(input, true)));
    hrtim
        .fltinr1()
        .modify(|w| INPUTS.map(|input| w.set_fltlck(input, true)));
    let armed = hrtim.tim(BRIDGE).flt();
    armed.modify(|w| INPUTS.map(|input| w.set_flten(input, true)));
    armed.modify(|w| w.set_fltlck(true));
}

/// PWR_CR2. EXTI_RTSR1 and EXTI_IMR1: a sag is kept in EXTI_PR1; its interrupt stays masked in the NVIC.
fn start_supply_detector() {
    pac::EXTI.rtsr(0).modify(|w| w.set_line(PVD_LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(PVD_LINE, true));
    pac::PWR.cr2().modify(|w| w.set_pls(PVD_LEVEL));
    pac::PWR.cr2().modify(|w| w.set_pvde(true));
}

/// Clears what has tripped: HRTIM_ICR; EXTI_PR1, cleared by writing 1.
pub fn clear() {
    pac::HRTIM1.icr().write(|w| {
        for input in INPUTS {
            w.set_flt(input, true);
        }
        w.set_sysflt(true);
    });
    pac::EXTI.pr(0).write(|w| w.set_line(PVD_LINE, true));
}

/// Fault that has opened the bridge in hardware while a switch should be closed (HRTIM, HRTIM_ISR: FLT1, FLT2, FLT4, SYSFLT). The first
/// switch that closes clears the flags of an earlier fault. Outputs in FAULT state without a flag are what a halt by a debugger leaves
/// that is too short for the sampling watchdog: a current that stays at the trip level is seen in the samples. A fault counts, once,
/// even if the path has opened the bridge since, as at the end of a pot probe; what trips with both switches open does not. The thread
/// has the path only with interrupts masked, so no block closes a switch between the readings of drive and flags.
pub fn hardware_fault<M: PairArithmetic>(path: &SamplingPath<M>) -> Option<Fault> {
    let mut isr = HrtimIsr(KEPT_FLAGS.swap(0, Ordering::Relaxed));
    let is_driven = path.drive().bridge != Bridge::Open;
    // Before the flags: what trips in between has one.
    let is_lost = is_driven && are_outputs_off();
    if is_driven {
        isr.0 |= pac::HRTIM1.isr().read().0;
    }
    // A supply that is still low holds the outputs in FAULT state after its flag was cleared.
    if isr.sysflt() || is_driven && is_supply_low() {
        // Of the four causes only lock-up leaves no flag.
        Some(system_fault().unwrap_or(Fault::CORE_LOCKUP))
    } else if COMPARATORS.iter().any(|&input| isr.flt(input)) {
        Some(Fault::HARDWARE_OVER_CURRENT)
    } else if isr.flt(SAMPLING_WATCHDOG) || is_lost {
        Some(Fault::SAMPLES_LOST)
    } else {
        None
    }
}

/// HRTIM, HRTIM_OENR: both outputs are in their idle or FAULT state, as they are before HRTIM has its clock (RCC, RCC_APB2ENR).
pub fn are_outputs_off() -> bool {
    let has_clock = pac::RCC.apb2enr().read().hrtim1en();
    let are_on = || {
        let enabled = pac::HRTIM1.oenr().read();
        enabled.t1oen(BRIDGE) || enabled.t2oen(BRIDGE)
    };
    !(has_clock && are_on())
}

/// HRTIM_ISR as the path last opened the bridge, until [`hardware_fault`] has read it.
static KEPT_FLAGS: AtomicU32 = AtomicU32::new(0);

/// Keeps the flags of all faults for [`hardware_fault`]; to be called before the path opens the bridge.
#[inline(always)]
pub fn keep_flags() {
    KEPT_FLAGS.store(pac::HRTIM1.isr().read().0, Ordering::Relaxed);
}

/// Reads the two fault inputs of [`COMPARATORS`], `true` if tripped (HRTIM, HRTIM_ISR): that of the inverted current, that of the
/// current.
pub fn comparators_tripped() -> [bool; 2] {
    let isr = pac::HRTIM1.isr().read();
    COMPARATORS.map(|input| isr.flt(input))
}

/// Returns `true` if the sampling watchdog has bitten (HRTIM, HRTIM_ISR: FLT2).
pub fn is_sampling_stopped() -> bool {
    pac::HRTIM1.isr().read().flt(SAMPLING_WATCHDOG)
}

/// Cause of HRTIM's system fault that has left a flag: FLASH, FLASH_ECCR (ECCD, ECCD2: two
/// wrong bits in either half of a word of two banks); SYSCFG, SYSCFG_CFGR2 (SPF); PWR, PWR_SR2
/// (PVDO, which goes when the supply is back) and EXTI, EXTI_PR1 ([`PVD_LINE`], which stays).
pub fn system_fault() -> Option<Fault> {
    let ecc = pac::FLASH.eccr().read();
    if ecc.eccd() || ecc.eccd2() {
        Some(Fault::FLASH_ECC)
    } else if pac::SYSCFG.cfgr2().read().spf() {
        Some(Fault::RAM_PARITY)
    } else if is_supply_low() || pac::EXTI.pr(0).read().line(PVD_LINE) {
        Some(Fault::SUPPLY_LOW)
    } else {
        None
    }
}

/// PWR, PWR_SR2: the supply is below [`PVD_LEVEL`].
fn is_supply_low() -> bool {
    pac::PWR.sr2().read().pvdo()
}
