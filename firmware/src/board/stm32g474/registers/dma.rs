//! DMA1: channel 1 takes pairs, channel 2 bus and mains, both circular.

use core::sync::atomic::{Ordering, compiler_fence};

use embassy_stm32::pac;
use embassy_stm32::pac::bdma::vals::{Dir, Pl, Size};
use ihd_firmware::sense::dma_buffer::DmaHalves;

/// DMAMUX inputs (DMAMUX, table "DMAMUX: assignment of multiplexer inputs to resources").
const REQUEST_ADC1: u8 = 5;
const REQUEST_ADC3: u8 = 37;

const PAIRS: usize = 0;
const SLOW: usize = 1;

/// The common data register of ADC1 and ADC2 into a ring of words; interrupts at each half.
///
/// # Safety
/// `pairs` must stay valid, with the DMA as only writer, for as long as the program runs.
pub unsafe fn start_pairs(pairs: *mut u32, length: u16) {
    let from = pac::ADC12_COMMON.cdr().as_ptr() as u32;
    connect(PAIRS, REQUEST_ADC1, from, pairs as u32, length);
    pac::DMA1.ch(PAIRS).cr().write(|w| {
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
}

/// ADC3's data register into a ring of half-words.
///
/// # Safety
/// As [`start_pairs`], for `codes`.
pub unsafe fn start_slow(codes: *mut i16, length: u16) {
    let from = pac::ADC3.dr().as_ptr() as u32;
    connect(SLOW, REQUEST_ADC3, from, codes as u32, length);
    pac::DMA1.ch(SLOW).cr().write(|w| {
        w.set_dir(Dir::FROM_PERIPHERAL);
        w.set_circ(true);
        w.set_minc(true);
        w.set_psize(Size::BITS16);
        w.set_msize(Size::BITS16);
        w.set_en(true);
    });
}

fn connect(channel: usize, request: u8, from: u32, to: u32, length: u16) {
    pac::DMAMUX1
        .ccr(channel)
        .write(|w| w.set_dmareq_id(request));
    let channel = pac::DMA1.ch(channel);
    channel.par().write_value(from);
    channel.mar().write_value(to);
    channel.ndtr().write(|w| w.set_ndt(length));
    compiler_fence(Ordering::SeqCst);
}

/// DMA, DMA_ISR and DMA_IFCR: halves filled since the last call.
pub fn filled() -> DmaHalves {
    let isr = pac::DMA1.isr().read();
    let filled = DmaHalves {
        first: isr.htif(PAIRS),
        second: isr.tcif(PAIRS),
    };
    pac::DMA1.ifcr().write(|w| {
        w.set_htif(PAIRS, filled.first);
        w.set_tcif(PAIRS, filled.second);
        w.set_teif(PAIRS, isr.teif(PAIRS));
    });
    filled
}

/// DMA, DMA_CNDTRx: words until the end of the double block.
pub fn words_left() -> u16 {
    pac::DMA1.ch(PAIRS).ndtr().read().ndt()
}
