//! ADC1 with ADC2 for pairs, ADC3 for bus and mains, with one trigger for all; ADC4 for temperatures, started by software.
//!
//! The clock is HCLK/4 = 42.5 MHz on all of them. ES0430 2.7.11: converters that convert at the same time disturb one another
//! unless they have one clock and one trigger. Pairs, bus and mains have one trigger, at any phase of the two
//! dividers, as its period of 3·m/8 cycles is rarely a multiple of 4; ADC4 has none, for 12 µs each millisecond: a trigger
//! would start it again and again. In a public report (ST's community, "Strangely accurate ADC noise") codes of ADC4 fall to
//! the next lower xxx11111, by up to 31, 1.6 % of the reference's. The bench has to show which do here (docs/bring-up.md, D8,
//! E10).
//!
//! ADCx_CCR may be written only while the ADCs are off, and comes first: calibration runs at the same clock, and 60 MHz are
//! the most (DS12288, ADC characteristics, f_ADC).

use embassy_stm32::pac;
use embassy_stm32::pac::adc::vals::{Dmacfg as OwnDmacfg, Dmaen, Exten, Ovrmod, SampleTime};
use embassy_stm32::pac::adccommon::vals::{Ckmode, Dmacfg, Dual, Mdma};

use super::clocks::CORE_MHZ;
use super::dma;

/// Regular trigger 21: hrtim_adc_trg1 on every ADC (ADC, tables "ADC1/2 and ADC3/4/5 - External
/// triggers for regular channels").
const TRIGGER: u8 = 21;

/// Middle of the range: codes are signed from here on.
const MIDDLE: u16 = 2_048;

/// ADC, ADC_OFRy: signed codes of one channel.
fn make_signed(adc: pac::adc::Adc, offset: usize, channel: u8) {
    adc.ofr(offset).write(|w| {
        w.set_offset(MIDDLE);
        w.set_offset1_ch(channel);
        w.set_offset_en(true);
    });
}

/// Sets the sampling time of a channel (RM0440: ADC, ADC_SMPRx).
fn set_sample_time(adc: pac::adc::Adc, channel: u8, time: SampleTime) {
    match channel {
        0..10 => adc.smpr().modify(|w| w.set_smp(usize::from(channel), time)),
        _ => adc
            .smpr2()
            .modify(|w| w.set_smp(usize::from(channel) - 10, time)),
    }
}

/// ADC, "ADC deep-power-down mode and ADC voltage regulator", "Calibration": out of deep power-down first,
/// then the regulator by a second write (ST's `HAL_ADC_Init`: `LL_ADC_DisableDeepPowerDown`, then
/// `LL_ADC_EnableInternalRegulator`), t_ADCVREG_STUP, calibration.
///
/// ADC_CR is written, not modified: it holds bits that software can only set, and a bit that reads 1
/// would be set again (ST's `ADC_CR_BITS_PROPERTY_RS`).
fn wake(adc: pac::adc::Adc) {
    adc.cr().write(|_| {});
    adc.cr().write(|w| w.set_advregen(true));
    // t_ADCVREG_STUP is 20 µs.
    cortex_m::asm::delay(CORE_MHZ * 20);
    adc.cr().write(|w| {
        w.set_advregen(true);
        w.set_adcal(true);
    });
    while adc.cr().read().adcal() {}
    // ADEN must wait four ADC clocks after the calibration (ADC, "ADC on-off control"), 16 cycles here.
    cortex_m::asm::delay(64);
}

/// Enables the ADC (RM0440: ADC, "ADC on-off control").
fn enable(adc: pac::adc::Adc) {
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().write(|w| {
        w.set_advregen(true);
        w.set_aden(true);
    });
    while !adc.isr().read().adrdy() {}
}

/// ADC, "Starting conversions": each trigger starts one.
fn start(adc: pac::adc::Adc) {
    adc.cr().write(|w| {
        w.set_advregen(true);
        w.set_adstart(true);
    });
}

/// ADC, "Dual ADC modes", regular simultaneous: ADC1 with ADC2, one trigger, one 32-bit word a pair, into
/// a circular DMA of two blocks.
///
/// # Safety
/// As [`dma::start_pairs`].
pub unsafe fn start_pairs(voltage: u8, current: u8, pairs: *mut u32, length: u16) {
    pac::ADC12_COMMON.ccr().write(|w| {
        w.set_ckmode(Ckmode::SYNC_DIV4);
        w.set_dual(Dual::DUAL_R);
        w.set_mdma(Mdma::ENABLED12B10B);
        w.set_dmacfg(Dmacfg::CIRCULAR);
    });
    for (adc, channel) in [(pac::ADC1, voltage), (pac::ADC2, current)] {
        wake(adc);
        enable(adc);
        make_signed(adc, 0, channel);
        set_sample_time(adc, channel, SampleTime::CYCLES2_5);
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
    // SAFETY: what the caller promises.
    unsafe { dma::start_pairs(pairs, length) };
    start(pac::ADC1);
}

/// ADC3 converts bus and mains in turn, one a trigger (ADC, "Discontinuous mode"), into a circular
/// DMA of `length` half-words, an even number.
///
/// One takes 6.5 + 12.5 cycles and at most 3 to begin (DS12288, t_LATR): 518 ns. Triggers come every
/// 3 / 61 of 12.5 µs, 615 ns, at the highest frequency; with a sampling time of 12.5 cycles one would
/// take 659 ns, and every other trigger be lost. 153 ns of sampling are enough behind the capacitor that
/// both dividers have at the pin.
///
/// # Safety
/// As [`dma::start_slow`].
pub unsafe fn start_slow(bus: u8, mains: u8, codes: *mut i16, length: u16) {
    pac::ADC345_COMMON.ccr().write(|w| {
        w.set_ckmode(Ckmode::SYNC_DIV4);
        // The reference reaches ADC4; may change only while all three are off.
        w.set_vrefen(true);
    });
    wake(pac::ADC3);
    enable(pac::ADC3);
    make_signed(pac::ADC3, 0, mains);
    for channel in [bus, mains] {
        set_sample_time(pac::ADC3, channel, SampleTime::CYCLES6_5);
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
        w.set_dmaen(Dmaen::ENABLE);
        w.set_dmacfg(OwnDmacfg::CIRCULAR);
        w.set_extsel(TRIGGER);
        w.set_exten(Exten::RISING_EDGE);
    });
    // SAFETY: what the caller promises.
    unsafe { dma::start_slow(codes, length) };
    start(pac::ADC3);
}

/// Returns `true` if ADC3's overrun (ADC, ADC_ISR: OVR) keeps bus and mains from the DMA, as any end of its channel does two
/// conversions later. After one the codes' places are no longer known, so only a reset mends it.
pub fn is_slow_stopped() -> bool {
    pac::ADC3.isr().read().ovr()
}

/// ADC4, one channel at a time, each sampled for 247.5 cycles, 5.8 µs: the source is 5 kΩ behind 100 nF. Its clock is that of
/// [`start_slow`], which must come before.
pub fn start_single(channels: &[u8]) {
    wake(pac::ADC4);
    enable(pac::ADC4);
    for &channel in channels {
        set_sample_time(pac::ADC4, channel, SampleTime::CYCLES247_5);
    }
    pac::ADC4.cfgr().modify(|w| w.set_ovrmod(Ovrmod::OVERWRITE));
}

/// Starts two conversions of a channel by ADC4: one that begins more than 1 ms after the last, or after the calibration, may be
/// wrong, the next is not (ES0430 2.7.7). Ignored while one is under way: then ADC_SQR1 may not be written.
pub fn convert(channel: u8) {
    if pac::ADC4.cr().read().adstart() {
        return;
    }
    pac::ADC4.sqr1().write(|w| {
        w.set_l(1);
        w.set_sq(0, channel);
        w.set_sq(1, channel);
    });
    start(pac::ADC4);
}

/// Takes the second of the two conversions since the last call; EOS, the end of the sequence, is cleared by writing 1.
pub fn converted() -> Option<u16> {
    if !pac::ADC4.isr().read().eos() {
        return None;
    }
    pac::ADC4.isr().write(|w| w.set_eos(true));
    Some(pac::ADC4.dr().read().rdata())
}
