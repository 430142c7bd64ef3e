//! Speed of the estimators and of the link: `cargo bench --profile full -p ihd-tests --bench estimation`.
//!
//! Inputs are the recorded half-cycle tests/fixtures/half_cycle/45k-snr30 (behavioural reference
//! load, 45 kHz, 12 bit, 61/3, noise of 30 dB), so that branches and convergence are those of real data. Without the
//! feature `pinn` the network is left out.

use std::hint::black_box;
use std::path::Path;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use ihd_firmware::drive::bridge::Drive;
use ihd_firmware::estimate::ekf::{Ekf, Noise};
use ihd_firmware::link::transmit_queue::TransmitQueue;
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_firmware::sense::correlation::correlate;
use ihd_firmware::sense::demodulator::{Demodulator, Phasors};
use ihd_link::receiver::Receiver;
use ihd_link::{Client, DeviceEvent};
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, Pair, block_ns};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::frame::MAX_ENCODED;
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::SharedHob;

/// The f64 twins, as peers in the same run.
#[path = "../oracle.rs"]
mod oracle;

/// Switching frequency of the fixture, in hertz.
const F_SW_HZ: u32 = 45_000;

/// Start values of the filters: the nominal load, 4 Ω and 25 µH.
const START: (MicroOhm, PicoHenry) = (MicroOhm(4_000_000), PicoHenry(25_000_000));

/// The fixture's pairs in whole blocks.
fn blocks() -> Vec<[Pair; ADC_LOCK_P]> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/half_cycle/45k-snr30.pairs");
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (pairs, _) = bytes.as_chunks::<4>();
    let pairs: Vec<Pair> = pairs.iter().map(|&b| Pair::from_le_bytes(b)).collect();
    pairs.as_chunks::<ADC_LOCK_P>().0.to_vec()
}

/// The fixture's phasors, as the demodulator gives them.
fn phasors(blocks: &[[Pair; ADC_LOCK_P]]) -> Vec<Phasors> {
    let mut demod = Demodulator::new(F_SW_HZ);
    let sums = blocks.iter().map(correlate);
    sums.filter_map(|sums| demod.push(&sums)).collect()
}

fn demodulator(c: &mut Criterion) {
    let blocks = blocks();
    let mut group = c.benchmark_group("demodulator");
    group.throughput(Throughput::Elements(ADC_LOCK_P as u64));
    group.bench_function("one block: correlate", |b| {
        b.iter(|| correlate(black_box(&blocks[75])));
    });
    let mut demod = Demodulator::new(F_SW_HZ);
    group.bench_function("one block: correlate, boxcars", |b| {
        b.iter(|| demod.push(&correlate(black_box(&blocks[75]))));
    });
    group.throughput(Throughput::Elements((blocks.len() * ADC_LOCK_P) as u64));
    group.bench_function("half-cycle, firmware", |b| {
        b.iter(|| phasors(black_box(&blocks)));
    });
    group.bench_function("half-cycle, f64 twin", |b| {
        b.iter(|| oracle::demodulate(black_box(&blocks), F_SW_HZ));
    });
    group.finish();
}

fn filter(c: &mut Criterion) {
    let blocks = blocks();
    let fixed = phasors(&blocks);
    let (_, float) = oracle::demodulate(&blocks, F_SW_HZ);
    let mut group = c.benchmark_group("filter, updates of one half-cycle");
    group.throughput(Throughput::Elements(fixed.len() as u64));
    let mut ekf = Ekf::new(F_SW_HZ, START.0, START.1, Noise::TUNED);
    group.bench_function("fixed point", |b| {
        b.iter(|| fixed.iter().for_each(|z| ekf.step(black_box(z))));
    });
    let (r_ohm, l_h) = (START.0.ohm(), START.1.henry());
    for (name, jacobian) in [
        ("f64 twin", oracle::Jacobian::Analytic),
        ("f64 twin, exact Jacobian", oracle::Jacobian::Exact),
    ] {
        let mut ekf = oracle::Ekf::new(F_SW_HZ, r_ohm, l_h, jacobian);
        group.bench_function(name, |b| {
            b.iter(|| {
                for &(v, i) in &float {
                    ekf.step(black_box(v), i);
                }
                ekf.r_l()
            });
        });
    }
    group.finish();
}

fn lookup(c: &mut Criterion) {
    let lookup = prior();
    let mut i_ma = 0;
    c.bench_function("lookup, one interpolation", |b| {
        b.iter(|| {
            i_ma = (i_ma + 977) % 80_000;
            lookup.interpolate(black_box(45_678), i_ma)
        });
    });
}

/// A sampling path that has recorded the fixture as a window: the bridge goes on at the first zero
/// crossing, the window begins with the second and is complete soon after the third.
fn recorded(blocks: &[[Pair; ADC_LOCK_P]]) -> Box<SamplingPath> {
    let mut sampling_path = Box::new(SamplingPath::new(START.0, START.1));
    sampling_path.recorder().set_period(1);
    sampling_path.request(Drive::switching(F_SW_HZ));
    let mut since_ns = 0;
    for pairs in blocks.iter().cycle().take(5 * blocks.len()) {
        let crosses = since_ns >= 10_000_000;
        let block = AdcBlock {
            pairs,
            zero_crossing: crosses.then_some(0),
            bus: BusReading::steady(3_000),
            dc_link_ma: None,
            lost: 0,
        };
        since_ns = if crosses { 0 } else { since_ns };
        let drive = sampling_path.on_block(&block);
        since_ns += block_ns(drive.f_sw_hz);
        if sampling_path.recorder().ready().is_some() {
            break;
        }
    }
    sampling_path
}

/// Every frame of the recorded window.
fn transmitted(sampling_path: &mut SamplingPath) -> Vec<u8> {
    let hello = ours(ROLE_DEVICE, CAP_SIMULATED, 1, "bench", "bench");
    let (mut queue, lookup) = (TransmitQueue::new(hello), prior());
    let mut frame = [0; MAX_ENCODED];
    let mut stream = Vec::new();
    loop {
        match queue.transmit(sampling_path, &lookup, &mut frame) {
            0 => return stream,
            length => stream.extend_from_slice(&frame[..length]),
        }
    }
}

/// The window that a stream holds.
fn received(stream: &[u8]) -> Option<DeviceEvent> {
    let mut receiver = Receiver::default();
    for &byte in stream {
        // The stream is whole; a bad frame would show as no window.
        let _ = receiver.push(byte);
    }
    receiver.events.pop_front()
}

fn window(c: &mut Criterion) {
    let blocks = blocks();
    let stream = transmitted(&mut recorded(&blocks));
    let Some(DeviceEvent::Window(window)) = received(&stream) else {
        panic!("{} bytes hold no window", stream.len());
    };
    let mut group = c.benchmark_group(format!("window of {} pairs", window.pairs.len()));
    group.throughput(Throughput::Bytes(stream.len() as u64));
    group.bench_function("encode", |b| {
        b.iter_batched_ref(
            || recorded(&blocks),
            |sampling_path| transmitted(sampling_path),
            BatchSize::LargeInput,
        );
    });
    group.bench_function("decode", |b| b.iter(|| received(black_box(&stream))));
    group.finish();
}

/// The simulated hob, firmware included: simulated time passes as fast as this.
fn hob(c: &mut Criterion) {
    let hob = SharedHob::new(SimHob::new(&HobConfig::default()));
    let half_cycle = || {
        let mut hob = hob.lock();
        let end_s = hob.t_s() + 10e-3;
        while hob.t_s() < end_s {
            hob.step();
        }
    };
    let mut client = Client::connect(Box::new(hob.clone())).expect("the hob answers");
    client.set_power(1_500).expect("the hob heats");
    (0..60).for_each(|_| half_cycle());
    c.bench_function("hob, one half-cycle at 1500 W", |b| {
        // A host that falls silent is switched off.
        b.iter_batched(
            || client.status(),
            |_| half_cycle(),
            BatchSize::PerIteration,
        );
    });
}

criterion_group!(benches, demodulator, filter, lookup, window, hob);
criterion_main!(benches);
