//! Every register that embassy-stm32 does not cover, by the chapter of the reference manual RM0440
//! and the register's name there. Nothing else in the firmware writes to these.
//!
//! HRTIM timer A drives the half-bridge, timer B triggers the ADCs; both count the same ticks and
//! are started and updated by the same write, so their ratio and phase hold.
//!
//! What a compiler cannot check (trigger and request numbers, which comparator reaches which fault
//! input, pins and thresholds of the comparators) was compared with two independent sources: ST's own
//! drivers (github.com/STMicroelectronics/stm32g4xx-hal-driver: `LL_ADC_REG_TRIG_EXT_HRTIM_TRG1`,
//! `LL_DMAMUX_REQ_ADC1/3`, `LL_COMP_INPUT_PLUS_IO1`, `LL_COMP_INPUT_MINUS_DAC1_CH1/2`,
//! `HRTIM_FAULTSOURCE_INTERNAL`) and github.com/stm32-rs/stm32g4xx-hal (`impl_faults!`). It has not
//! run on a board.

pub mod clocks;
pub mod comparators;

use core::sync::atomic::{Ordering, compiler_fence};

use embassy_stm32::pac;
use embassy_stm32::pac::adc::vals::{Exten, Ovrmod, SampleTime};
use embassy_stm32::pac::adccommon::vals::{Ckmode, Dmacfg, Dual, Mdma};
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use embassy_stm32::pac::hrtim::vals::Fault as FaultState;
use ihd_firmware::pwm::{DEAD_TIME_NS, Periods};
use ihd_firmware::reset::Flags;
use ihd_firmware::ring::Filled;
use ihd_shared::fault::Fault;

/// Indices of the timers in HRTIM.
const BRIDGE: usize = 0;
const SAMPLING: usize = 1;

/// HRTIM prescaler 2 (table "HRTIM resolution and min. PWM frequency" in HRTIM): 8 ticks a cycle.
const PRESCALER: u8 = 2;

/// Regular trigger 21: hrtim_adc_trg1 on every ADC (ADC, tables "ADC1/2 and ADC3/4/5 - External
/// triggers for regular channels").
const TRIGGER: u8 = 21;

/// DMAMUX inputs (DMAMUX, table "DMAMUX: assignment of multiplexer inputs to resources").
const REQUEST_ADC1: u8 = 5;
const REQUEST_ADC3: u8 = 37;

/// EXTI line of the supply's detector (EXTI, table "EXTI lines connections").
const PVD_LINE: usize = 16;

/// Middle of the range: codes are signed from here on.
const MIDDLE: u16 = 2_048;

/// HRTIM, HRTIM_ODISR: the outputs take their idle state, which is low.
pub fn bridge_off() {
    pac::HRTIM1.odisr().write(|w| {
        w.set_t1odis(BRIDGE, true);
        w.set_t2odis(BRIDGE, true);
    });
}

/// HRTIM, HRTIM_OENR: the lower switch alone. It is the complement of the upper one's signal, so it is closed for half
/// of each period, which charges the bootstrap capacitor; the upper one stays open.
pub fn bridge_lower_on() {
    clear_faults();
    pac::HRTIM1.oenr().modify(|w| w.set_t2oen(BRIDGE, true));
}

/// HRTIM, HRTIM_OENR, after HRTIM_ICR has cleared what tripped before.
pub fn bridge_on() {
    clear_faults();
    pac::HRTIM1.oenr().modify(|w| {
        w.set_t1oen(BRIDGE, true);
        w.set_t2oen(BRIDGE, true);
    });
}

fn clear_faults() {
    pac::HRTIM1.icr().write(|w| {
        w.set_flt(0, true);
        w.set_flt(3, true);
        w.set_sysflt(true);
    });
    // EXTI_PR1: cleared by writing 1.
    pac::EXTI.pr(0).write(|w| w.set_line(PVD_LINE, true));
}

/// What has switched the bridge off in hardware (HRTIM, HRTIM_ISR: FLT1, FLT4, SYSFLT).
pub fn hardware_fault() -> Option<Fault> {
    let isr = pac::HRTIM1.isr().read();
    if isr.sysflt() {
        // Of the four causes only lock-up leaves no flag.
        Some(system_fault().unwrap_or(Fault::CORE_LOCKUP))
    } else if isr.flt(0) || isr.flt(3) {
        Some(Fault::HARDWARE_OVER_CURRENT)
    } else {
        None
    }
}

/// Which of the causes of HRTIM's system fault has left a flag: FLASH, FLASH_ECCR (ECCD, ECCD2: two
/// wrong bits in either half of a word of two banks); SYSCFG, SYSCFG_CFGR2 (SPF); PWR, PWR_SR2
/// (PVDO, which goes when the supply is back) and EXTI, EXTI_PR1 ([`PVD_LINE`], which stays).
pub fn system_fault() -> Option<Fault> {
    let ecc = pac::FLASH.eccr().read();
    if ecc.eccd() || ecc.eccd2() {
        Some(Fault::FLASH_ECC)
    } else if pac::SYSCFG.cfgr2().read().spf() {
        Some(Fault::RAM_PARITY)
    } else if pac::PWR.sr2().read().pvdo() || pac::EXTI.pr(0).read().line(PVD_LINE) {
        Some(Fault::SUPPLY_LOW)
    } else {
        None
    }
}

/// HRTIM, "HRTIM initialization": DLL, both timers, outputs, faults. HRTIM is clocked and reset
/// already; the bridge stays off.
pub fn start_timers(periods: Periods) {
    let hrtim = pac::HRTIM1;
    // HRTIM_DLLCR: calibrate once, then every 6.168 ms.
    hrtim.dllcr().write(|w| w.set_cal(true));
    while !hrtim.isr().read().dllrdy() {}
    hrtim.dllcr().write(|w| {
        w.set_calen(true);
        w.set_calrte(3);
    });
    for timer in [BRIDGE, SAMPLING] {
        // HRTIM_TIMxCR: continuous, preloaded, updated by software alone.
        hrtim.tim(timer).cr().write(|w| {
            w.set_ckpsc(PRESCALER);
            w.set_cont(true);
            w.set_preen(true);
        });
    }
    let bridge = hrtim.tim(BRIDGE);
    // HRTIM_DTAR. Prescaler 3 makes a step of one HRTIM cycle. Both dead times and their
    // signs are locked until reset.
    let steps = (DEAD_TIME_NS * 170).div_ceil(1_000) as u16;
    bridge.dt().write(|w| {
        w.set_dtprsc(3);
        w.set_dtr(steps);
        w.set_dtf(steps);
    });
    // HRTIM_SETA1R, RSTA1R: on at the period, off at compare 1. Output 2 is its
    // complement with dead time.
    bridge.setr(0).write(|w| w.set_per(true));
    bridge.rstr(0).write(|w| w.set_cmp(0, true));
    // HRTIM_OUTAR: idle and fault states low.
    bridge.outr().write(|w| {
        w.set_dten(true);
        for output in 0..2 {
            w.set_fault(output, FaultState::SET_INACTIVE);
        }
    });
    bridge.dt().modify(|w| {
        w.set_dtrlk(true);
        w.set_dtflk(true);
        w.set_dtrslk(true);
        w.set_dtfslk(true);
    });
    start_faults();
    // HRTIM_ADC1R: trigger 1 on the sampling timer's period.
    hrtim.adc1r(0).write(|w| w.set_adctper(SAMPLING, true));
    set_periods(periods);
    // HRTIM_MCR: both counters in one write.
    hrtim.mcr().modify(|w| {
        w.set_tcen(BRIDGE, true);
        w.set_tcen(SAMPLING, true);
    });
}

/// HRTIM, HRTIM_FLTINR1 and HRTIM_FLTAR: COMP2 on input 1, COMP1 on input 4, active high,
/// unfiltered; locked until reset. SYSCFG, SYSCFG_CFGR2: lock-up, RAM parity and ECC errors and a
/// sagging supply reach HRTIM's system fault. EXTI, EXTI_RTSR1 and EXTI_IMR1: a sag of the supply is
/// kept; its interrupt stays masked in the NVIC.
fn start_faults() {
    let hrtim = pac::HRTIM1;
    for input in [0, 3] {
        hrtim.fltinr1().modify(|w| {
            w.set_fltsrc(input, true);
            w.set_fltp(input, true);
            w.set_flte(input, true);
            w.set_fltlck(input, true);
        });
        hrtim.tim(BRIDGE).flt().modify(|w| w.set_flten(input, true));
    }
    hrtim.tim(BRIDGE).flt().modify(|w| w.set_fltlck(true));
    pac::SYSCFG.cfgr2().modify(|w| {
        w.set_cll(true);
        w.set_spl(true);
        w.set_pvdl(true);
        w.set_eccl(true);
    });
    pac::EXTI.rtsr(0).modify(|w| w.set_line(PVD_LINE, true));
    pac::EXTI.imr(0).modify(|w| w.set_line(PVD_LINE, true));
}

/// New periods for both timers, at the same moment: HRTIM, HRTIM_PERxR, HRTIM_CMP1xR, then
/// software update and counter reset in one write of HRTIM_CR2.
pub fn set_periods(periods: Periods) {
    let hrtim = pac::HRTIM1;
    let bridge = hrtim.tim(BRIDGE);
    bridge.per().write(|w| w.set_per(periods.switching));
    bridge.cmp(0).write(|w| w.set_cmp(periods.half()));
    hrtim
        .tim(SAMPLING)
        .per()
        .write(|w| w.set_per(periods.sampling));
    hrtim.cr2().write(|w| {
        for timer in [BRIDGE, SAMPLING] {
            w.set_tswu(timer, true);
            w.set_trst(timer, true);
        }
    });
}

/// ADC, "ADC deep-power-down mode and voltage regulator" to "ADC on-off control": regulator, calibration and switching on, for one ADC; its clock runs.
fn wake_adc(adc: pac::adc::Adc) {
    adc.cr().write(|w| w.set_advregen(true));
    // t_ADCVREG_STUP is 20 µs.
    cortex_m::asm::delay(170 * 20);
    adc.cr().modify(|w| w.set_adcal(true));
    while adc.cr().read().adcal() {}
    // ADEN must wait four ADC clocks after the calibration, 16 cycles here.
    cortex_m::asm::delay(64);
}

fn enable_adc(adc: pac::adc::Adc) {
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    while !adc.isr().read().adrdy() {}
}

/// ADC, ADC_OFRy: signed codes of one channel.
fn make_signed(adc: pac::adc::Adc, offset: usize, channel: u8) {
    adc.ofr(offset).write(|w| {
        w.set_offset(MIDDLE);
        w.set_offset1_ch(channel);
        w.set_offset_en(true);
    });
}

/// ADC, "Dual ADC modes", regular simultaneous: ADC1 with ADC2, one trigger, one 32-bit word a pair, into
/// a circular DMA of two blocks. The clock is HCLK/4 = 42.5 MHz on all ADCs, synchronous with
/// HRTIM, as erratum ES0430 2.7.11 wants it.
///
/// # Safety
/// `pairs` must stay valid and be written by nobody else for as long as the program runs.
pub unsafe fn start_pairs(voltage: u8, current: u8, pairs: *mut u32, length: u16) {
    wake_adc(pac::ADC1);
    wake_adc(pac::ADC2);
    // ADCx_CCR may be written only while both are off.
    pac::ADC12_COMMON.ccr().modify(|w| {
        w.set_ckmode(Ckmode::SYNC_DIV4);
        w.set_dual(Dual::DUAL_R);
        w.set_mdma(Mdma::ENABLED12B10B);
        w.set_dmacfg(Dmacfg::CIRCULAR);
    });
    for (adc, channel) in [(pac::ADC1, voltage), (pac::ADC2, current)] {
        enable_adc(adc);
        make_signed(adc, 0, channel);
        adc.smpr()
            .modify(|w| w.set_smp(usize::from(channel), SampleTime::CYCLES2_5));
        adc.sqr1().write(|w| {
            w.set_l(0);
            w.set_sq(0, channel);
        });
        adc.cfgr().modify(|w| w.set_ovrmod(Ovrmod::OVERWRITE));
    }
    pac::ADC1.cfgr().modify(|w| {
        w.set_extsel(TRIGGER);
        w.set_exten(Exten::RISING_EDGE);
    });
    let channel = pac::DMA1.ch(0);
    pac::DMAMUX1.ccr(0).write(|w| w.set_dmareq_id(REQUEST_ADC1));
    channel
        .par()
        .write_value(pac::ADC12_COMMON.cdr().as_ptr() as u32);
    channel.mar().write_value(pairs as u32);
    channel.ndtr().write(|w| w.set_ndt(length));
    compiler_fence(Ordering::SeqCst);
    channel.cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(Size::BITS32);
        w.set_msize(Size::BITS32);
        w.set_pl(Pl::VERY_HIGH);
        w.set_htie(true);
        w.set_tcie(true);
        w.set_en(true);
    });
    pac::ADC1.cr().modify(|w| w.set_adstart(true));
}

/// ADC3 converts bus and mains in turn, one a trigger (ADC, "Discontinuous mode"), into a circular
/// DMA of two half-words.
///
/// # Safety
/// As [`start_pairs`], for `codes`.
pub unsafe fn start_slow(bus: u8, mains: u8, codes: *mut i16) {
    wake_adc(pac::ADC3);
    pac::ADC345_COMMON
        .ccr()
        .modify(|w| w.set_ckmode(Ckmode::SYNC_DIV4));
    enable_adc(pac::ADC3);
    make_signed(pac::ADC3, 0, mains);
    for channel in [bus, mains] {
        let n = usize::from(channel);
        if n < 10 {
            pac::ADC3
                .smpr()
                .modify(|w| w.set_smp(n, SampleTime::CYCLES12_5));
        } else {
            pac::ADC3
                .smpr2()
                .modify(|w| w.set_smp(n - 10, SampleTime::CYCLES12_5));
        }
    }
    pac::ADC3.sqr1().write(|w| {
        w.set_l(1);
        w.set_sq(0, bus);
        w.set_sq(1, mains);
    });
    pac::ADC3.cfgr().modify(|w| {
        w.set_ovrmod(Ovrmod::OVERWRITE);
        w.set_discen(true);
        w.set_discnum(0);
        w.set_dmaen(pac::adc::vals::Dmaen::ENABLE);
        w.set_dmacfg(pac::adc::vals::Dmacfg::CIRCULAR);
        w.set_extsel(TRIGGER);
        w.set_exten(Exten::RISING_EDGE);
    });
    let channel = pac::DMA1.ch(1);
    pac::DMAMUX1.ccr(1).write(|w| w.set_dmareq_id(REQUEST_ADC3));
    channel.par().write_value(pac::ADC3.dr().as_ptr() as u32);
    channel.mar().write_value(codes as u32);
    channel.ndtr().write(|w| w.set_ndt(2));
    compiler_fence(Ordering::SeqCst);
    channel.cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(Size::BITS16);
        w.set_msize(Size::BITS16);
        w.set_en(true);
    });
    pac::ADC3.cr().modify(|w| w.set_adstart(true));
}

/// DMA, DMA_ISR and DMA_IFCR: halves filled since this was asked last.
pub fn filled() -> Filled {
    let isr = pac::DMA1.isr().read();
    let filled = Filled {
        first: isr.htif(0),
        second: isr.tcif(0),
    };
    pac::DMA1.ifcr().write(|w| {
        w.set_htif(0, filled.first);
        w.set_tcif(0, filled.second);
        w.set_teif(0, isr.teif(0));
    });
    filled
}

/// DMA, DMA_CNDTRx: words until the end of the double block.
pub fn words_left() -> u16 {
    pac::DMA1.ch(0).ndtr().read().ndt()
}

/// RCC, RCC_CSR: why the controller started; cleared for the next time.
pub fn reset_flags() -> Flags {
    let csr = pac::RCC.csr().read();
    let flags = Flags {
        watchdog: csr.iwdgrstf() || csr.wwdgrstf(),
        software: csr.sftrstf(),
        brown_out: csr.borrstf(),
        pin: csr.pinrstf(),
    };
    pac::RCC.csr().modify(|w| w.set_rmvf(true));
    flags
}
