//! Counts instructions on QEMU's mps2-an386: under `-icount shift=0` the emulator's clock advances 1 ns each, and
//! SysTick, at 25 MHz, once every 40. Prints one line a subject over semihosting, and ends.

mod float_filter;

use core::hint::black_box;
use core::panic::PanicInfo;

use cortex_m::Peripherals;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_semihosting::{debug, hprintln};
use ihd_firmware::control::power::PowerControl;
use ihd_firmware::estimate::ekf::{Ekf, Noise};
use ihd_firmware::fixed::Complex;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::half_cycle::{CurrentCrest, HalfCycle};
use ihd_firmware::sampling::path::{AdcBlock, SamplingLock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_firmware::sense::correlation::correlate_by;
use ihd_firmware::sense::current_transformer::apparent_r;
use ihd_firmware::sense::demodulator::{Demodulator, Phasors};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::window::CHUNK_BYTES;
use ihd_shared::wire::frame::{MAX_ENCODED, encode};
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_shared::wire::messages::{Raw, WindowChunk};

use self::float_filter::FloatEkf;
use crate::board::dsp::DspArithmetic;
use crate::board::sampling;

/// Times each subject runs: 40 instructions of resolution over 200 runs are 0.2.
const RUNS: u32 = 200;

/// Instructions per tick of SysTick: 1 ns each, at 25 MHz.
const PER_TICK: u32 = 40;

const TOP: u32 = 0x00FF_FFFF;

/// Tenths of an instruction per run of `subject`, the loop around it taken off.
fn tenths(mut subject: impl FnMut(u32)) -> u32 {
    let ticks = |f: &mut dyn FnMut()| {
        let before = SYST::get_current();
        f();
        // Counts down, 24 bit.
        before.wrapping_sub(SYST::get_current()) & TOP
    };
    let all = ticks(&mut || {
        for k in 0..RUNS {
            subject(black_box(k));
        }
    });
    let empty = ticks(&mut || {
        for k in 0..RUNS {
            black_box(k);
        }
    });
    all.saturating_sub(empty) * PER_TICK * 10 / RUNS
}

fn report(name: &str, tenths: u32) {
    hprintln!("count {} {}.{}", name, tenths / 10, tenths % 10);
}

/// A pot at 70 kHz: a triangle for the voltage, a lagging one for the current.
fn block() -> [Pair; ADC_LOCK_P] {
    core::array::from_fn(|n| {
        let turn = (n as i32 * 3 * 1_024 / ADC_LOCK_P as i32) % 1_024;
        let wave = |at: i32| {
            let at = at.rem_euclid(1_024);
            (if at < 512 { at - 256 } else { 768 - at }) as i16
        };
        Pair {
            v: 3 * wave(turn),
            i: 2 * wave(turn - 200),
        }
    })
}

/// No interrupt is ever unmasked here; link.x insists on a table.
#[unsafe(link_section = ".vector_table.interrupts")]
#[unsafe(no_mangle)]
pub static __INTERRUPTS: [usize; 1] = [0];

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    debug::exit(debug::EXIT_FAILURE);
    unreachable!("the emulator has ended")
}

#[cortex_m_rt::entry]
fn main() -> ! {
    if let Some(peripherals) = Peripherals::take() {
        let mut clock = peripherals.SYST;
        clock.set_clock_source(SystClkSource::Core);
        clock.set_reload(TOP);
        clock.clear_current();
        clock.enable_counter();
        estimator();
        sampling_path();
        lookup_and_link();
        debug::exit(debug::EXIT_SUCCESS);
    }
    debug::exit(debug::EXIT_FAILURE);
    unreachable!("the emulator has ended")
}

fn estimator() {
    let pairs = block();
    let correlated = tenths(|_| {
        black_box(correlate_by::<DspArithmetic>(black_box(&pairs)));
    });
    report("pair", correlated / ADC_LOCK_P as u32);
    let sums = correlate_by::<DspArithmetic>(&pairs);
    let mut demod = Demodulator::new(70_000);
    report(
        "boxcars",
        tenths(|_| {
            black_box(demod.push(black_box(&sums)));
        }),
    );
    let mut ekf = Ekf::new(
        70_000,
        MicroOhm(4_000_000),
        PicoHenry(25_000_000),
        Noise::TUNED,
    );
    report(
        "ekf",
        tenths(|k| {
            ekf.step(black_box(&phasors(k)));
        }),
    );
    let mut float = FloatEkf::new(70_000.0, 4.0, 25e-6);
    report(
        "ekf-f32",
        tenths(|k| {
            let z = phasors(k);
            float.step(black_box([
                z.v.re as f32 * FloatEkf::VOLT,
                z.v.im as f32 * FloatEkf::VOLT,
                z.i.re as f32 * FloatEkf::AMPERE,
                z.i.im as f32 * FloatEkf::AMPERE,
            ]));
        }),
    );
    // Both filters see the same phasors: the counts compare the same work only where they end at the same load.
    let ratios = [
        (ekf.r().0 + apparent_r(ekf.l()).0) as f32 / (float.r_ohm() * 1e6),
        ekf.l().0 as f32 / (float.l_h() * 1e12),
    ];
    let agree = ratios.iter().all(|ratio| (ratio - 1.0).abs() <= 1e-3);
    assert!(agree, "the f32 filter ends elsewhere: ratios {ratios:?}");
}

/// Phasors of 4.4 ohm and 25 µH at 70 kHz under an envelope that rises and falls.
fn phasors(k: u32) -> Phasors {
    let rise = (k % 100).min(100 - k % 100) as i32 + 20;
    let i = 1_200_000 * rise;
    // V = (4.4 + j·11.0) ohm · I in units of 32 V and 16 A: 2.2 + j·5.5.
    Phasors {
        v: Complex {
            re: (i64::from(i) * 22 / 10) as i32,
            im: (i64::from(i) * 55 / 10) as i32,
        },
        i: Complex { re: i, im: 0 },
    }
}

/// The whole path, as the interrupt runs it: replayed, so that the estimator runs, with a window
/// being recorded.
fn sampling_path() {
    let (r, l) = (MicroOhm(4_000_000), PicoHenry(25_000_000));
    let Some((_, mut path)) = sampling::split(r, l) else {
        return;
    };
    let pairs = block();
    path.with(|path| {
        path.recorder().set_period(1);
        path.set_replay(true, 70_000, r, l);
        take(path, &pairs, Some(0));
        report("block", tenths(|_| take(path, &pairs, None)));
        // 200 blocks of 42.9 µs have passed: the next crossing counts. One run is all there is.
        let before = SYST::get_current();
        take(path, &pairs, Some(30));
        let ticks = before.wrapping_sub(SYST::get_current()) & TOP;
        report("block-at-crossing", ticks * PER_TICK * 10);
    });
}

fn take(
    path: &mut SamplingPath<DspArithmetic>,
    pairs: &[Pair; ADC_LOCK_P],
    zero_crossing: Option<u8>,
) {
    black_box(path.replay_block(&AdcBlock {
        pairs,
        zero_crossing,
        bus: BusReading::steady(3_000),
        dc_link_ma: None,
        lost: 0,
    }));
}

/// Not inlined, so that what is counted here does not depend on the rest.
#[inline(never)]
fn lookup_and_link() {
    let lookup = prior();
    report(
        "lookup",
        tenths(|k| {
            black_box(lookup.interpolate(black_box(40_000 + 100 * k), black_box(150 * k)));
        }),
    );
    report("search-step", longest_search_step(&lookup));
    let data = [0xA5; CHUNK_BYTES];
    let mut frame = [0; MAX_ENCODED];
    report(
        "window-chunk",
        tenths(|k| {
            let chunk = WindowChunk {
                seq: k,
                offset: 240,
                data: Raw(black_box(&data)),
            };
            black_box(encode(&chunk, k as u16, &mut frame).is_ok());
        }),
    );
    // Once per half-cycle below the sampling path: control on a summary.
    let hello = ours(ROLE_DEVICE, CAP_SIMULATED, 0, "", "");
    black_box(Housekeeping::new(hello));
}

/// Tenths of instructions of the longest step in searches for 100 to 2,000 W.
fn longest_search_step(lookup: &RlLookup) -> u32 {
    let mut control = PowerControl::default();
    let mut longest = 0;
    for asked_mw in (100_000..=2_000_000).step_by(100_000) {
        let (r, l) = lookup.interpolate(50_000, 20_000);
        let summary = HalfCycle {
            f_sw_hz: 50_000,
            power_mw: 800_000,
            bus_peak_dv: 3_253,
            crest: CurrentCrest {
                r,
                l,
                i_ma: 20_000,
                ..CurrentCrest::default()
            },
            ..HalfCycle::default()
        };
        control.begin(&summary, asked_mw);
        while control.is_searching() {
            let before = SYST::get_current();
            black_box(control.advance(lookup));
            longest = longest.max(before.wrapping_sub(SYST::get_current()) & TOP);
        }
    }
    longest * PER_TICK * 10
}
