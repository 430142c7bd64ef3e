//! Simulated hob: the plant with the firmware lib as its controller, block by block.
//!
//! There is no control logic here. Like the board's interrupt and tasks, this file passes blocks to [`SamplingPath`], bytes to
//! [`Housekeeping`], and the drive back to the plant. Zero crossings and bus voltage come from the firmware's detector on noisy
//! codes; the truth counts half-cycles by the mains itself.

mod board;
mod config;
mod link;
mod watchdog;

use std::collections::VecDeque;

pub use ihd_firmware::control::request::PanelEvent;
use ihd_firmware::control::share_wire::WireDrive;
use ihd_firmware::drive::bridge::{Bridge, Drive};
use ihd_firmware::drive::soft_start::{self, SoftStart};
use ihd_firmware::limits::SAMPLING_WATCHDOG_US;
use ihd_firmware::link::channel_test::SlowCodes;
use ihd_firmware::link::housekeeping::Housekeeping;
use ihd_firmware::link::identity::DeviceIdentity;
use ihd_firmware::retained::reset::{CrashRecord, ResetReason};
use ihd_firmware::sampling::path::{AdcBlock, SamplingPath};
use ihd_firmware::sense::bus::{BUS_MEAN, BusReading};
use ihd_firmware::sense::mains::ZeroCrossingDetector;
use ihd_firmware::sense::supply::SupplyScale;
use ihd_shared::fault::Fault;
use ihd_shared::hob::NODE_CAPACITANCE_NF;
use ihd_shared::lookup::prior::start_load;
use ihd_shared::sampling::{ADC_LOCK_P, Pair};
use ihd_shared::wire::hello::{CAP_SIMULATED, ROLE_DEVICE, ours};
use ihd_signal::truth::{MapTruth, Truth};

use board::{SimulatedBoard, comparator_a, reference};
pub use config::{BENCH_TRANSFORMER_V, HobConfig};
use watchdog::Watchdog;

use super::adc::HOLD_DELAY_S;
use super::injection::{InjectionKind, Injections};
use super::inverter::InverterError;
use super::mains::SimulatedMains;
use super::meter::MeterReading;
use super::plant::Plant;
use super::pot::SimulatedPot;
use super::recent_truths::RecentTruths;
use super::slow_adc::SlowAdc;
use super::temperatures::{Heat, LumpTemperatures};
use super::thermal_model::ThermalModel;

/// Time after the start of a half-cycle, in seconds, by which its drive is in force: the detector may see a crossing a block early
/// or late.
const SETTLED_AFTER_S: f64 = 0.5e-3;

/// ADC samples per point of the kept truth: 9 µs at 45 kHz.
const TRUTH_EVERY: usize = 8;

const SAMPLING_WATCHDOG_S: f64 = SAMPLING_WATCHDOG_US as f64 * 1e-6;

/// Period at which the board converts its thermistors and its reference voltage, in seconds.
const SLOW_READINGS_S: f64 = 4e-3;

/// FLASH_OPTR of a board with correct option bytes: as delivered (RM0440, "FLASH option register": 0xFFEF F8AA) with SRAM_PE, bit
/// 24, cleared and BOR_LEV, bits 10:8, at 4.
const OPTION_BYTES: u32 = 0xFEEF_FCAA;

fn booted_sampling_path() -> Box<SamplingPath> {
    let (r, l) = start_load();
    Box::new(SamplingPath::new(r, l))
}

fn booted_housekeeping(boot_id: u32, reason: ResetReason, starts: u8) -> Housekeeping {
    let build = concat!("ihd-firmware ", env!("CARGO_PKG_VERSION"));
    let mut hello = ours(ROLE_DEVICE, CAP_SIMULATED, boot_id, build, "simulated hob");
    hello.reset_reason = reason as u8;
    let mut housekeeping = Housekeeping::new(hello);
    housekeeping.set_identity(identity(starts));
    housekeeping
}

fn identity(starts: u8) -> DeviceIdentity {
    DeviceIdentity {
        option_bytes: OPTION_BYTES,
        starts,
        ..DeviceIdentity::default()
    }
}

/// Simulated hob.
pub struct SimHob {
    plant: Plant,
    /// The firmware's last drive, and the upper switch's share of it.
    drive: (Drive, u32),
    soft_start: SoftStart,
    slow_adc: SlowAdc,
    zero_crossing: ZeroCrossingDetector,
    sampling_path: Box<SamplingPath>,
    housekeeping: Housekeeping,
    boot_id: u32,
    starts: u8,
    watchdog: Watchdog,
    injections: Injections,
    temperatures: LumpTemperatures,
    ntc: bool,
    dc_link: bool,
    /// Wire to the other zone of a shared supply, `true` while that one pulls it low; `None` if there is no wire.
    share_wire: Option<bool>,
    wire_drive: WireDrive,
    reading: Option<MeterReading>,
    /// Time of the next reading of thermistors and reference voltage, in seconds.
    next_slow_s: f64,
    /// Number of blocks lost since the last one that arrived.
    lost: u32,
    inbound: VecDeque<u8>,
    outbound: VecDeque<u8>,
    /// Limit of bytes that wait for the host before the firmware's output is paused.
    outbound_room: usize,
    link_bytes_per_s: f64,
    link_credit: f64,
    truth: Truth,
    truths: RecentTruths,
}

impl SimHob {
    /// Creates a hob that was just switched on, at a mains zero crossing.
    ///
    /// # Panics
    /// If the pot has no model, or a setting is invalid; [`SimHob::assemble`] returns that as an error.
    pub fn new(config: &HobConfig) -> Self {
        Self::assemble(config).expect("a pot that has a model")
    }

    /// Creates a hob like [`SimHob::new`].
    ///
    /// # Errors
    /// If there is no model of the pot, or no such parts of the supply.
    pub fn assemble(config: &HobConfig) -> Result<Self, InverterError> {
        let boot_id = config.boot.unwrap_or(config.seed as u32);
        let mut plant = config.plant()?;
        plant.set_hold_delay(HOLD_DELAY_S);
        let trip_a = comparator_a(SupplyScale::NOMINAL, &Injections::default());
        plant.set_comparator(trip_a);
        Ok(Self {
            plant,
            drive: (Drive::OFF, soft_start::WHOLE_SHARE),
            soft_start: SoftStart::new(),
            slow_adc: SlowAdc::new(config.seed),
            zero_crossing: ZeroCrossingDetector::default(),
            sampling_path: booted_sampling_path(),
            housekeeping: booted_housekeeping(boot_id, ResetReason::PowerOn, 1),
            boot_id,
            starts: 1,
            watchdog: Watchdog::default(),
            injections: Injections::default(),
            temperatures: LumpTemperatures::at(config.ambient_c),
            ntc: config.ntc,
            dc_link: config.dc_link,
            share_wire: None,
            wire_drive: WireDrive::default(),
            reading: None,
            next_slow_s: 0.0,
            lost: 0,
            inbound: VecDeque::new(),
            outbound: VecDeque::new(),
            outbound_room: usize::MAX,
            link_bytes_per_s: config.link_bytes_per_s,
            link_credit: 0.0,
            truth: Truth::default(),
            truths: RecentTruths::default(),
        })
    }

    /// Simulates one block of 61 samples.
    pub fn step(&mut self) {
        if self.watchdog.has_given_up() {
            self.sample();
            self.take_power_reading();
            return;
        }
        let start_s = self.plant.t_s();
        let (drive, slow) = self.run_block();
        let end_s = self.plant.t_s();
        self.put_in_force(drive);
        let (drive, _) = self.drive;
        let since_s = self.plant.mains().since_crossing_s(end_s);
        if drive.is_switching() && self.truth.f_sw_hz == 0.0 && since_s > SETTLED_AFTER_S {
            self.truth.f_sw_hz = f64::from(drive.f_sw_hz);
        }
        self.run_link(end_s - start_s);
        let restarts = self.run_thread(slow);
        self.after_block();
        if restarts {
            self.restart();
        }
        let blocks = self.sampling_path.blocks();
        if self.watchdog.bites(blocks, self.plant.t_s()) {
            self.restart_after(ResetReason::Watchdog);
        }
    }

    /// Takes the next block from the converters and runs the sampling path on it; returns the drive that it wants, `None` if the block
    /// is lost, and the codes of the slow converter.
    fn run_block(&mut self) -> (Option<Drive>, SlowCodes) {
        let start_s = self.plant.t_s();
        let link_before_c = self.plant.link_charge_c();
        let mut pairs = self.sample();
        let end_s = self.plant.t_s();
        let half = self.plant.divided().half;
        let slow = self.slow_adc.block(self.plant.divided());
        let slow = self.injections.on_slow(slow);
        self.injections.on_pairs(&mut pairs);
        let codes = SlowCodes {
            bus: slow.bus[BUS_MEAN - 1],
            mains: slow.mains as i16,
        };
        if self.injections.on_block() {
            // After a reset there is no last one.
            self.lost += u32::from(self.sampling_path.blocks() > 0);
            return (None, codes);
        }
        let crossing = self.zero_crossing.on_block(slow.mains);
        let scale = self.housekeeping.control().supply_scale();
        let words = Pair::words(&pairs).map(|word| scale.pair(word));
        let block = AdcBlock {
            pairs: Pair::of_words(&words),
            zero_crossing: self.injections.on_crossing(crossing, start_s, end_s),
            bus: BusReading::new(slow.bus, half, scale),
            dc_link_ma: self.dc_link.then(|| {
                let charge_c = self.plant.link_charge_c() - link_before_c;
                // A current that flows back reads as zero.
                (1e3 * charge_c / (end_s - start_s)).round().max(0.0) as u32
            }),
            lost: std::mem::take(&mut self.lost),
        };
        (Some(self.run_sampling_path(&block, end_s)), codes)
    }

    /// Runs the sampling path on a block that ends at `end_s` seconds; returns the drive that it wants.
    fn run_sampling_path(&mut self, block: &AdcBlock<'_>, end_s: f64) -> Drive {
        let due_s = end_s + SAMPLING_WATCHDOG_S;
        let bites = self.plant.feed_sampling_watchdog(due_s);
        if bites && self.sampling_path.drive().bridge != Bridge::Open {
            self.sampling_path.raise(Fault::SAMPLES_LOST);
        }
        self.sampling_path.on_block(block)
    }

    /// Runs what the firmware's thread does between two blocks; returns `true` if it asks for a restart.
    fn run_thread(&mut self, slow: SlowCodes) -> bool {
        self.housekeeping.poll(&mut *self.sampling_path);
        let mut board = SimulatedBoard {
            slow,
            reference: reference(&self.injections),
            restarts: false,
        };
        self.housekeeping
            .serve(&mut *self.sampling_path, &mut board);
        let is_high = match self.share_wire {
            Some(other_pulls) => !other_pulls && self.wire_drive != WireDrive::Low,
            None => self.wire_drive == WireDrive::WeaklyUp,
        };
        self.wire_drive = self
            .housekeeping
            .share_supply(&mut *self.sampling_path, is_high);
        board.restarts
    }

    /// Passes a drive to the bridge as the board does: both switches open and the lower one closes at once, new periods begin a
    /// block later, with the block after the one that runs. A lost block brings no drive (`None`): then only those periods begin.
    fn put_in_force(&mut self, drive: Option<Drive>) {
        let before = self.drive;
        if let Some(drive) = drive {
            self.drive = (drive, self.soft_start.on_block(drive));
        }
        let (due, share) = match self.drive.0.is_switching() {
            true => before,
            false => self.drive,
        };
        self.plant.set_drive(due);
        self.plant
            .set_duty(0.5 * f64::from(share) / f64::from(soft_start::WHOLE_SHARE));
    }

    /// Restarts the controller as after a reset, with an empty link; pot, mains and temperatures continue.
    pub fn restart(&mut self) {
        self.restart_after(ResetReason::Software);
    }

    fn restart_after(&mut self, reason: ResetReason) {
        let (kept, fault) = CrashRecord::kept_control(Some(CrashRecord {
            fault: self.sampling_path.fault().number(),
            control: self.housekeeping.control().retained(),
            ..CrashRecord::default()
        }));
        self.starts = self.starts.saturating_add(1);
        self.boot_id = self.boot_id.wrapping_add(1);
        self.sampling_path = booted_sampling_path();
        self.housekeeping = booted_housekeeping(self.boot_id, reason, self.starts);
        self.housekeeping
            .restore_control(&mut *self.sampling_path, kept, fault);
        self.wire_drive = WireDrive::default();
        self.lost = 0;
        let t_s = self.plant.t_s();
        self.next_slow_s = t_s;
        self.watchdog.start(t_s);
        self.plant.feed_sampling_watchdog(t_s + SAMPLING_WATCHDOG_S);
        self.zero_crossing = ZeroCrossingDetector::default();
        self.inbound.clear();
        self.outbound.clear();
        let drive = self.sampling_path.drive();
        self.put_in_force(Some(drive));
    }

    /// Simulates a block of samples, and its truth.
    fn sample(&mut self) -> [Pair; ADC_LOCK_P] {
        let mains = self.plant.mains();
        let (truth, truths) = (&mut self.truth, &mut self.truths);
        let mut k = 0u8;
        self.plant.block(|plant| {
            let half_cycle = mains.half_cycle(plant.t_s());
            if half_cycle != truth.half_cycle {
                let next = Truth {
                    half_cycle,
                    ..Truth::default()
                };
                truths.push(std::mem::replace(truth, next));
            }
            if usize::from(k).is_multiple_of(TRUTH_EVERY) {
                let point = plant.load_point();
                truth.t_s.push(mains.since_crossing_s(point.t_s));
                truth.r_ohm.push(point.r_ohm);
                truth.l_h.push(point.l_h);
                truth.i_a.push(point.i_a);
            }
            k += 1;
        })
    }

    /// Passes the readings of the board's hardware after a block.
    fn after_block(&mut self) {
        if self.plant.take_trip() {
            self.sampling_path.raise(Fault::HARDWARE_OVER_CURRENT);
        }
        if self.injections.is_supply_low() {
            self.plant.open_in_hardware();
            if self.sampling_path.drive().bridge != Bridge::Open {
                self.sampling_path.raise(Fault::SUPPLY_LOW);
            }
        }
        if self.plant.t_s() >= self.next_slow_s {
            self.next_slow_s = self.plant.t_s() + SLOW_READINGS_S;
            self.read_slowly();
        }
        self.take_power_reading();
    }

    /// Passes the codes of thermistors and reference voltage, and corrects the comparators' threshold.
    fn read_slowly(&mut self) {
        self.housekeeping.set_reference(reference(&self.injections));
        self.set_comparator();
        if self.ntc {
            let codes = self.temperatures.codes(&self.injections);
            self.housekeeping.set_temperatures(codes);
        }
    }

    /// Takes the wattmeter's reading of a half-cycle, if one has ended.
    fn take_power_reading(&mut self) {
        if let Some(reading) = self.plant.take_reading() {
            self.warm_up(&reading);
            self.reading = Some(reading);
        }
    }

    /// Updates the temperatures by a half-cycle.
    fn warm_up(&mut self, reading: &MeterReading) {
        let mains_v = self.plant.mains().peak_v;
        let bench_supply_v = self.plant.bench_supply_v();
        let bus_v = bench_supply_v.unwrap_or(mains_v);
        let node_f = f64::from(NODE_CAPACITANCE_NF) * 1e-9;
        let heat = Heat {
            i_mean_a: reading.i_mean_a,
            i_square_a2: reading.i_square_a2,
            // For a resistor on a sine the mean current is P·(4/π)/V̂. A bench supply feeds the bus past the rectifier.
            mains_a: match bench_supply_v.is_none() && bus_v > 1.0 {
                true => reading.power_w() * std::f64::consts::FRAC_2_PI * 2.0 / bus_v,
                false => 0.0,
            },
            // Each edge dissipates at most the energy of the whole bus voltage.
            edges_j: f64::from(reading.hard_edges) * 0.5 * node_f * bus_v * bus_v,
            glass_j: self.plant.take_glass_heat_j(reading.duration_s),
        };
        // A stopped program leaves the fan's pin an input.
        let fan = self.housekeeping.fan() && !self.watchdog.has_given_up();
        self.temperatures.advance(reading.duration_s, &heat, fan);
        let LumpTemperatures {
            glass_c,
            coil_c,
            ambient_c,
            ..
        } = self.temperatures;
        self.plant.set_surroundings(glass_c, ambient_c);
        self.plant.set_winding_temperature(coil_c);
    }

    /// Temperatures of heat sink, glass and coil, for reading and setting.
    pub fn temperatures(&mut self) -> &mut LumpTemperatures {
        &mut self.temperatures
    }

    /// Passes a user's action on the panel.
    pub fn panel(&mut self, event: PanelEvent) {
        self.housekeeping.panel(&mut *self.sampling_path, event);
    }

    /// Connects the wire to the other zone of a shared supply, `true` while that one pulls it low; `None` is no wire, or a broken
    /// one at the board without its resistor.
    pub fn set_share_wire(&mut self, wire: Option<bool>) {
        self.share_wire = wire;
    }

    /// Returns `true` while this hob pulls that wire low.
    pub fn pulls_share_wire(&self) -> bool {
        self.wire_drive == WireDrive::Low
    }

    /// Lets minutes pass at once for the firmware's times of cooking.
    pub fn pass_minutes(&mut self, minutes: u16) {
        self.housekeeping
            .pass_minutes(&mut *self.sampling_path, minutes);
    }

    /// Simulated time in seconds.
    pub fn t_s(&self) -> f64 {
        self.plant.t_s()
    }

    /// Puts another pot on the coil, or removes it.
    ///
    /// # Errors
    /// If there is no model of that pot; the old one stays.
    pub fn set_pot(&mut self, pot: impl Into<SimulatedPot>) -> Result<(), InverterError> {
        self.plant.set_pot(pot)
    }

    /// The power stage, for changes of what surrounds it.
    pub(crate) fn plant_mut(&mut self) -> &mut Plant {
        &mut self.plant
    }

    /// Pot on the coil.
    pub fn pot(&self) -> SimulatedPot {
        self.plant.pot()
    }

    /// Present state of pot and contents; `None` without a pot, or if they do not warm up.
    pub fn thermal(&self) -> Option<&ThermalModel> {
        self.plant.thermal()
    }

    /// Prepares a pot, so that putting it on later takes no time.
    ///
    /// # Errors
    /// If there is no model of that pot.
    pub fn prepare(&mut self, pot: &SimulatedPot) -> Result<(), InverterError> {
        self.plant.prepare(pot)
    }

    /// The mains.
    pub fn mains(&self) -> SimulatedMains {
        self.plant.mains()
    }

    /// Sets voltage in volt rms (0 for none) and frequency in hertz of the mains; the phase continues.
    pub fn set_mains(&mut self, v_rms_v: f64, frequency_hz: f64) {
        self.plant.change_mains(v_rms_v, frequency_hz);
    }

    /// Changes the injected faults.
    pub fn inject(&mut self, change: impl FnOnce(&mut Injections)) {
        change(&mut self.injections);
        let share = self.injections.product(InjectionKind::ResonanceCapacitance);
        self.plant.set_resonance_share(share);
        self.plant
            .set_current_sensor(self.injections.current_sensor());
        if self.injections.is_supply_low() {
            self.plant.open_in_hardware();
        }
        self.set_comparator();
    }

    fn set_comparator(&mut self) {
        let scale = self.housekeeping.control().supply_scale();
        let trip_a = comparator_a(scale, &self.injections);
        self.plant.set_comparator(trip_a);
    }

    /// Readings of the last true half-cycle, once after each.
    pub fn take_reading(&mut self) -> Option<MeterReading> {
        self.reading.take()
    }

    /// Time in seconds since both switches are open; `None` while one may be closed.
    pub fn open_since_s(&self) -> Option<f64> {
        self.plant.open_since_s()
    }

    /// Number of times that the watchdog has reset the controller.
    pub fn watchdog_bites(&self) -> u32 {
        self.watchdog.count()
    }

    /// The firmware's sampling path, for inspection.
    pub fn sampling_path(&self) -> &SamplingPath {
        &self.sampling_path
    }

    /// Truth of a completed half-cycle, if it is recent enough.
    pub fn truth(&self, half_cycle: u32) -> Option<Truth> {
        self.truths.get(half_cycle)
    }

    /// Truth of the last completed half-cycles, for a reader beside the simulation.
    pub fn truths(&self) -> &RecentTruths {
        &self.truths
    }

    /// Truth of a lookup for the pot on the coil; `progress` is called with the share done. The field model takes some seconds.
    ///
    /// # Errors
    /// If there is no model of it.
    pub fn map_truth(&self, progress: &mut dyn FnMut(f64)) -> Result<MapTruth, InverterError> {
        self.plant.map_truth(progress)
    }

    /// Gives it the number of a chip, as a board has one, until its next restart.
    pub fn set_chip(&mut self, chip: [u8; 12]) {
        self.housekeeping.set_identity(DeviceIdentity {
            chip: Some(chip),
            ..identity(self.starts)
        });
    }

    /// The firmware's housekeeping, for inspection by tests.
    pub fn housekeeping(&self) -> &Housekeeping {
        &self.housekeeping
    }
}

#[cfg(test)]
mod tests;
