//! Random blocks and random host frames on the whole controller, with overflow checks on: nothing
//! panics, and what must never happen does not.
//!
//! A million blocks (some 40 s of a hob) with the other tests; a number of one's own:
//! `IHD_SOAK_BLOCKS=1000000000 cargo test -p ihd-firmware --test soak -- --nocapture`.

use std::f64::consts::{FRAC_2_PI, TAU};

use ihd_firmware::control::request::PanelEvent;
use ihd_firmware::control::temperature::TemperatureCodes;
use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::drive::pwm;
use ihd_firmware::limits::{DITHER_MAX_PERMILLE, TRIES};
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::BusReading;
use ihd_firmware::sense::supply::SupplyScale;
use ihd_shared::fault::Fault;
use ihd_shared::hob::{RATED_POWER_W, RESONANCE_CAPACITANCE_NF};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::sampling::{ADC_LOCK_P, AMPERE_PER_CODE, CODE_MAX, CODE_MIN, Pair, VOLT_PER_CODE};
use ihd_shared::units::{MicroOhm, PicoHenry};
use ihd_shared::wire::frame::{MAX_ENCODED, encode_numbered};
use ihd_shared::wire::hello::{ROLE_DEVICE, ROLE_HOST, ours};
use ihd_shared::wire::messages::{
    ClearFault, Configure, GetStatus, Hello, Message, PushLookup, Raw, ReplayEnd, ReplayStart,
    ResetLookup, SetPower, State, Stream,
};
use ihd_shared::wire::number::Number;

/// Blocks of a half-cycle, near enough.
const HALF_CYCLE: u64 = 220;

/// Steps of the envelope of a pot's blocks.
const ENVELOPE: usize = 64;

/// R and X in ohm and crest current in ampere of the pot's samples, whatever the frequency.
const POT: (f64, f64, f64) = (4.2, 8.6, 26.0);

/// xorshift64*: any seed but 0.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, n: u64) -> u64 {
        (self.next() >> 33) % n
    }

    fn one_in(&mut self, n: u64) -> bool {
        self.below(n) == 0
    }
}

/// Subject of the samples.
#[derive(Clone, Copy)]
enum Samples {
    /// A pot, with the envelope of the mains.
    Pot,
    /// An empty coil.
    Air,
    /// Any codes.
    Noise,
    /// Nothing but the ends of the range, or zeros.
    Rails,
}

/// Blocks of a load of R and X in ohm at the crest currents of an envelope up to `crest_a`.
fn of_load(r_ohm: f64, x_ohm: f64, crest_a: f64) -> Vec<[Pair; ADC_LOCK_P]> {
    (0..ENVELOPE)
        .map(|k| {
            let i_a = crest_a * k as f64 / (ENVELOPE - 1) as f64;
            core::array::from_fn(|n| {
                // The current lags the bridge's voltage by a fifth of a period.
                let angle = TAU * ((3 * n) as f64 / 61.0 - 0.2);
                let i = i_a * angle.sin();
                let v = i_a * (r_ohm * angle.sin() + x_ohm * angle.cos());
                let code =
                    |x: f64| x.round().clamp(f64::from(CODE_MIN), f64::from(CODE_MAX)) as i16;
                Pair {
                    v: code(v / VOLT_PER_CODE),
                    i: code(i / AMPERE_PER_CODE),
                }
            })
        })
        .collect()
}

struct Soak {
    random: Random,
    sampling_path: Box<SamplingPath>,
    housekeeping: Box<Housekeeping>,
    pot: Vec<[Pair; ADC_LOCK_P]>,
    air: Vec<[Pair; ADC_LOCK_P]>,
    samples: Samples,
    seq: u16,
    number: Number,
    states: [u64; 6],
    frames: u64,
    faults: u64,
}

impl Soak {
    fn new(seed: u64) -> Self {
        let hello = ours(ROLE_DEVICE, 0, 1, "soak", "soak");
        Self {
            random: Random(seed),
            sampling_path: Box::new(SamplingPath::new(
                MicroOhm(4_000_000),
                PicoHenry(26_000_000),
            )),
            housekeeping: Box::new(Housekeeping::new(hello)),
            pot: of_load(POT.0, POT.1, POT.2),
            air: of_load(0.15, 30.0, 7.0),
            samples: Samples::Pot,
            seq: 0,
            number: Number::NONE,
            states: [0; 6],
            frames: 0,
            faults: 0,
        }
    }

    fn pairs(&mut self, n: u64) -> [Pair; ADC_LOCK_P] {
        let phase = (n % HALF_CYCLE) as f64 / HALF_CYCLE as f64;
        let at = (ENVELOPE - 1) as f64 * (TAU * 0.5 * phase).sin();
        let mut pairs = match self.samples {
            Samples::Pot => self.pot[at as usize],
            Samples::Air => self.air[at as usize],
            Samples::Noise => core::array::from_fn(|_| {
                let bits = self.random.next();
                let code = |bits: u64| (bits & 0xFFF) as i16 - 2_048;
                Pair {
                    v: code(bits >> 20),
                    i: code(bits >> 40),
                }
            }),
            Samples::Rails => {
                let rails = [CODE_MIN, CODE_MAX, 0];
                let (v, i) = (self.random.below(3) as usize, self.random.below(3) as usize);
                [Pair {
                    v: rails[v],
                    i: rails[i],
                }; ADC_LOCK_P]
            }
        };
        // No two blocks of a converter are alike.
        pairs[0].v ^= (n & 3) as i16;
        if !self.sampling_path.drive().is_switching() && !self.random.one_in(50) {
            return [Pair::default(); ADC_LOCK_P];
        }
        pairs
    }

    /// The bus that drives the pot's current at this frequency, in decivolt: sensors that agree.
    fn bus_peak_dv(&self) -> f64 {
        let f_hz = f64::from(self.sampling_path.drive().f_sw_hz);
        let x_c_ohm = 1e9 / (TAU * f_hz * f64::from(RESONANCE_CAPACITANCE_NF));
        let (r_ohm, x_ohm, crest_a) = POT;
        10.0 * crest_a * r_ohm.hypot(x_ohm - x_c_ohm) / FRAC_2_PI
    }

    fn block(&mut self, n: u64) {
        if self.random.one_in(20 * HALF_CYCLE) {
            self.samples = match self.random.below(12) {
                0 => Samples::Noise,
                1 => Samples::Rails,
                2..4 => Samples::Air,
                _ => Samples::Pot,
            };
        }
        let pairs = self.pairs(n);
        let phase = (n % HALF_CYCLE) as f64 / HALF_CYCLE as f64;
        let stray = self.random.one_in(5_000);
        let crossing = n.is_multiple_of(HALF_CYCLE) != stray;
        let bus = if self.random.one_in(20_000) {
            let codes = core::array::from_fn(|_| self.random.next() as u16);
            BusReading::new(codes, (n % 2) as usize, SupplyScale::NOMINAL)
        } else {
            BusReading::steady((self.bus_peak_dv() * (TAU * 0.5 * phase).sin()) as u16)
        };
        let was = self.sampling_path.fault();
        let drive = self.sampling_path.on_block(&AdcBlock {
            pairs: &pairs,
            zero_crossing: crossing.then(|| self.random.below(255) as u8),
            bus,
            dc_link_ma: self
                .random
                .one_in(1_000)
                .then_some(self.random.next() as u32),
            lost: u32::from(self.random.one_in(20_000)),
        });
        let fault = self.sampling_path.fault();
        self.faults += u64::from(fault != Fault::NONE && was == Fault::NONE);
        let f_sw_hz = drive.f_sw_hz;
        assert!(
            (pwm::MIN_HZ..=pwm::MAX_HZ).contains(&f_sw_hz),
            "{f_sw_hz} Hz"
        );
        if fault != Fault::NONE {
            assert_eq!(drive.bridge, Bridge::Open, "block {n}: {fault}");
        }
        if self.housekeeping.control().state() == State::LockedOut {
            assert_eq!(drive.bridge, Bridge::Open, "block {n}: locked out");
        }
        // A thread that is late now and then.
        if !self.random.one_in(10) {
            self.housekeeping.poll(&mut *self.sampling_path);
            self.after_poll(n);
        }
    }

    fn after_poll(&mut self, n: u64) {
        let control = self.housekeeping.control();
        let state = control.state();
        self.states[state as usize] += 1;
        assert!(control.asked_w() <= RATED_POWER_W && control.restart().tries_left() <= TRIES);
        // With a fault active, the request before has no effect.
        let wants = self.sampling_path.requested_drive().is_switching()
            && self.sampling_path.fault() == Fault::NONE
            && !self.sampling_path.is_replaying();
        let may = matches!(
            state,
            State::Probing | State::Heating | State::WaitingForPot
        );
        assert!(
            may || !wants,
            "block {n}: {state:?} and the bridge is wanted"
        );
        assert!(control.temperatures().power_percent() <= 100);
    }

    fn send(&mut self, bytes: &[u8]) {
        self.frames += 1;
        self.housekeeping.receive(&mut *self.sampling_path, bytes);
        let mut out = [0; MAX_ENCODED];
        while self
            .housekeeping
            .transmit(&mut *self.sampling_path, &mut out)
            > 0
        {}
    }

    fn message(&mut self, message: &impl Message) {
        let mut frame = [0; MAX_ENCODED];
        self.seq = self.seq.wrapping_add(1);
        self.number = match self.random.below(20) {
            // Again, or one that is past.
            0 => self.number,
            1 => Number::FIRST,
            _ => self.number.next(),
        };
        let length = encode_numbered(message, self.number, self.seq, &mut frame).expect("it fits");
        if self.random.one_in(30) {
            let at = self.random.below(length as u64) as usize;
            frame[at] ^= 1 << self.random.below(8);
        }
        self.send(&frame[..length]);
    }

    fn hello(&mut self) {
        let hello: Hello = ours(ROLE_HOST, 0, 2, "soak", "host");
        self.message(&hello);
    }

    fn host(&mut self) {
        let bits = self.random.next();
        match self.random.below(14) {
            0 => self.hello(),
            1..5 => self.message(&SetPower {
                power_w: (bits % 2_700) as u16,
            }),
            5 => self.message(&SetPower { power_w: 0 }),
            6 => self.message(&ClearFault {}),
            7 => self.message(&GetStatus {}),
            8 => self.message(&Stream {
                telemetry_every: bits as u8,
                windows_every: (bits >> 8) as u8,
            }),
            9 => {
                let version = self
                    .housekeeping
                    .lookup()
                    .version
                    .wrapping_add(bits as u32 % 1_200);
                let mut lookup = RlLookup { version, ..prior() };
                for cell in lookup.r.iter_mut().chain(&mut lookup.l).flatten() {
                    *cell = (u32::from(*cell) * (600 + (bits >> 32) as u32 % 600) / 1_000) as u16;
                }
                lookup.observed.fill((bits >> 50) as u8);
                self.message(&PushLookup {
                    blob: Raw(&lookup.to_bytes()),
                });
            }
            10 => self.message(&Configure {
                give_up_s: (bits % 700) as u16,
                dither_permille: (bits >> 20) as u8 % (DITHER_MAX_PERMILLE + 2),
            }),
            11 => self.message(&ResetLookup {}),
            12 if bits.is_multiple_of(8) => {
                self.message(&ReplayStart {
                    f_sw_hz: (bits >> 10) as u32 % 90_000,
                    r: MicroOhm(bits as i32),
                    l: PicoHenry((bits >> 32) as i32),
                });
                self.message(&ReplayEnd {});
            }
            _ => {
                let noise: [u8; 24] = core::array::from_fn(|_| self.random.next() as u8);
                self.send(&noise);
            }
        }
    }

    /// A person at the panel, and what surrounds the hob.
    fn surroundings(&mut self) {
        let bits = self.random.next();
        let code = |shift: u32| {
            let present = (bits >> shift) & 7 != 0;
            // Room temperature, and anything now and then.
            let usual = if (bits >> (shift + 3)) & 15 == 0 {
                bits >> (shift + 7)
            } else {
                2_048
            };
            present.then_some((usual & 0xFFF) as u16)
        };
        self.housekeeping.set_temperatures(TemperatureCodes {
            heat_sink: code(0),
            glass: code(12),
            coil: code(24),
        });
        let event = match self.random.below(10) {
            0 => PanelEvent::KeyLock(bits & 15 == 0),
            1..4 => PanelEvent::Level(0),
            _ => PanelEvent::Level((bits >> 40) as u8 % 12),
        };
        self.housekeeping.panel(&mut *self.sampling_path, event);
    }
}

#[test]
fn nothing_panics_and_no_invariant_breaks() {
    let blocks: u64 = std::env::var("IHD_SOAK_BLOCKS")
        .ok()
        .map_or(1_000_000, |n| n.parse().expect("a number of blocks"));
    let mut soak = Soak::new(14);
    soak.hello();
    for n in 0..blocks {
        soak.block(n);
        if soak.random.one_in(2_000) {
            soak.host();
        }
        if soak.random.one_in(8_000) {
            soak.surroundings();
        }
        if n > 0 && n.is_multiple_of(100_000_000) {
            println!("{n} blocks, polls by state {:?}", soak.states);
        }
    }
    println!(
        "{blocks} blocks, {} frames, {} faults, polls by state (idle, probing, heating, locked out, waiting, \
         pausing) {:?}",
        soak.frames, soak.faults, soak.states
    );
    // Every state was there, and the hob has heated.
    assert!(
        soak.states.iter().all(|&polls| polls > 0),
        "{:?}",
        soak.states
    );
    assert!(
        soak.states[State::Heating as usize] > blocks / 200,
        "{:?}",
        soak.states
    );
}
