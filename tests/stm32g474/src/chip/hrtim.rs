//! HRTIM: timer A drives the bridge, timer B triggers the ADCs; outputs with dead time, faults (RM0440, 27).
//!
//! A running timer is modelled by its period and the time of count 0; the counter is computed when it is read. Both timers
//! use prescaler 2 in this image, so one count is one tick; other prescalers are a violation.

mod faults;
mod outputs;

use crate::registers::{hrtim_common, hrtim_master, hrtim_tima, hrtim_timb};
use crate::time::{Ticks, us};
use crate::violation::Log;

use self::faults::sources_written;
pub use self::faults::{ActiveFaults, takes_comparator, takes_event_2};
use super::register_file::RegisterFile;

/// Duration of the DLL's calibration (RM0440, 27.3.4: 14 µs at 170 MHz).
const DLL_CALIBRATION: Ticks = us(14);

/// State of the bridge's two switches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Bridge {
    /// Both open.
    #[default]
    Open,
    /// Lower switch permanently closed.
    LowerClosed,
    /// Switches closed in turn.
    Switching {
        /// Period in ticks.
        period: u32,
        /// End of the upper switch's on-time in the period, in ticks.
        on: u32,
    },
}

/// Counter of a timer, with its active period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Counter {
    running: bool,
    /// Time of count 0: the last repetition event, reset or start.
    started: Ticks,
    period: u32,
}

impl Counter {
    fn count(&self, now: Ticks) -> u32 {
        if self.running && self.period > 0 {
            (now.saturating_sub(self.started) % Ticks::from(self.period)) as u32
        } else {
            0
        }
    }
}

/// HRTIM unit.
#[derive(Clone, Debug, Default)]
pub struct Hrtim {
    a: Counter,
    b: Counter,
    /// Active values of the preloaded registers, by address.
    active: [Vec<(u32, u32)>; 2],
    dll_ready_at: Option<Ticks>,
    enabled: [bool; 2],
    /// Time at which the outputs last went off.
    pub off_at: Option<Ticks>,
    dead_time_locked: bool,
    /// Faults whose cause is there now.
    pub active_faults: ActiveFaults,
    /// Time at which a debugger halted the core; the counters stand still since then.
    frozen_at: Option<Ticks>,
}

const OUTPUT_1: u32 = 1;
const OUTPUT_2: u32 = 2;

/// Preloaded registers that the image writes (RM0440, table 231); the period first.
const PRELOADED: [&[u32]; 2] = [
    &[
        hrtim_tima::perar::ADDRESS,
        hrtim_tima::cmp1ar::ADDRESS,
        hrtim_tima::seta1r::ADDRESS,
        hrtim_tima::rsta1r::ADDRESS,
        hrtim_tima::dtar::ADDRESS,
    ],
    &[hrtim_timb::perbr::ADDRESS, hrtim_timb::cmp3br::ADDRESS],
];

impl Hrtim {
    /// Time of the next trigger of the ADCs by timer B: its compare 3, if HRTIM_ADC1R selects it.
    pub fn next_trigger(&self, file: &RegisterFile, now: Ticks) -> Option<Ticks> {
        let on = self.b.running
            && self.frozen_at.is_none()
            && self.b.period > 0
            && file.is(hrtim_common::adc1r::AD1TBC3);
        on.then(|| {
            let compare = Ticks::from(self.in_force(1, hrtim_timb::cmp3br::ADDRESS));
            let period = Ticks::from(self.b.period);
            let elapsed = (now + period).saturating_sub(self.b.started + compare);
            self.b.started + compare + elapsed / period * period
        })
    }

    /// Time from the begin of timer B's period to its trigger of the ADCs.
    pub fn trigger_delay(&self) -> Ticks {
        Ticks::from(self.in_force(1, hrtim_timb::cmp3br::ADDRESS))
    }

    /// Time of the next repetition event that updates a timer (RM0440, 27.3.4, "Repetition counter").
    pub fn next_repetition(&self, file: &RegisterFile) -> Option<Ticks> {
        (0..2)
            .filter_map(|timer| self.repetition(timer, file))
            .min()
    }

    fn repetition(&self, timer: usize, file: &RegisterFile) -> Option<Ticks> {
        let counter = [&self.a, &self.b][timer];
        if !counter.running || self.frozen_at.is_some() || counter.period == 0 {
            return None;
        }
        let (by_repetition, repetitions) = if timer == 0 {
            use hrtim_tima::{repar, timacr};
            (file.is(timacr::TXREPU), file.get(repar::REPX))
        } else {
            use hrtim_timb::{repbr, timbcr};
            (file.is(timbcr::TXREPU), file.get(repbr::REPX))
        };
        let periods = Ticks::from(repetitions) + 1;
        by_repetition.then(|| counter.started + periods * Ticks::from(counter.period))
    }

    /// Processes repetition events that are due: preloaded values become active.
    pub fn repeat(&mut self, file: &RegisterFile, now: Ticks) {
        for timer in 0..2 {
            if self.repetition(timer, file).is_some_and(|at| now >= at) {
                let held = [hrtim_common::cr1::TAUDIS, hrtim_common::cr1::TBUDIS][timer];
                self.counter(timer).started = now;
                if !file.is(held) {
                    self.update(timer, file);
                }
            }
        }
    }

    fn counter(&mut self, timer: usize) -> &mut Counter {
        if timer == 0 { &mut self.a } else { &mut self.b }
    }

    /// Activates all preloaded values of a timer.
    fn update(&mut self, timer: usize, file: &RegisterFile) {
        self.active[timer] = PRELOADED[timer]
            .iter()
            .map(|&address| (address, file.word(address)))
            .collect();
        self.counter(timer).period = self.in_force(timer, PRELOADED[timer][0]);
    }

    /// Active value of a preloaded register.
    fn in_force(&self, timer: usize, address: u32) -> u32 {
        let found = self.active[timer].iter().find(|(at, _)| *at == address);
        found.map_or(0, |(_, value)| *value)
    }

    /// Present state of the switches.
    pub fn bridge(&self, file: &RegisterFile) -> Bridge {
        let set =
            hrtim_tima::seta1r::PER.extract(self.in_force(0, hrtim_tima::seta1r::ADDRESS)) == 1;
        let reset =
            hrtim_tima::rsta1r::CMP1.extract(self.in_force(0, hrtim_tima::rsta1r::ADDRESS)) == 1;
        let pwm = set && reset && self.a.running;
        match self.enabled {
            [true, true] if pwm => Bridge::Switching {
                period: self.a.period,
                on: self.in_force(0, hrtim_tima::cmp1ar::ADDRESS),
            },
            // With dead time, output 2 is the complement of output 1; no event sets output 1, or it is not on the pin.
            [_, true] if file.is(hrtim_tima::outar::DTEN) => Bridge::LowerClosed,
            _ => Bridge::Open,
        }
    }

    /// Returns `true` if the bridge's timer counts.
    pub fn is_running(&self) -> bool {
        self.a.running
    }

    /// Switching frequency by timer A's period, in hertz.
    pub fn f_sw_hz(&self) -> f64 {
        crate::time::TICKS_PER_S as f64 / f64::from(self.a.period.max(1))
    }

    /// Active dead times before the rising and after the falling edge of output 1, in seconds: steps of 2^DTPRSC / 8 cycles of
    /// 170 MHz (RM0440, 27.5.20).
    pub fn dead_times_s(&self) -> [f64; 2] {
        use hrtim_tima::dtar::{DTFX, DTPRSC, DTRX};
        let dead_time = self.in_force(0, hrtim_tima::dtar::ADDRESS);
        let step_s = f64::from(1u32 << DTPRSC.extract(dead_time)) / 8.0 / 170e6;
        [DTRX, DTFX].map(|steps| f64::from(steps.extract(dead_time)) * step_s)
    }

    fn switch_off(&mut self, now: Ticks) {
        if self.enabled != [false; 2] {
            self.enabled = [false; 2];
            self.off_at = Some(now);
        }
    }

    /// Handles a halt of the core with DBG_HRTIM_STOP = 1: the counters stand still, and outputs in RUN state enter FAULT state,
    /// which lasts until software enables them again (RM0440, 27.3.22, "HRTIM output states and transitions").
    pub fn freeze(&mut self, now: Ticks) {
        self.frozen_at.get_or_insert(now);
        self.switch_off(now);
    }

    /// Handles the end of a halt: the counters go on from where they stood.
    pub fn thaw(&mut self, now: Ticks) {
        let stood = self.frozen_at.take().map_or(0, |at| now - at);
        self.a.started += stood;
        self.b.started += stood;
    }

    /// Reads a register whose content is computed.
    pub fn read(&mut self, address: u32, file: &RegisterFile, now: Ticks) -> u32 {
        let word = file.word(address);
        match address {
            hrtim_common::isr::ADDRESS => {
                let ready = self.dll_ready_at.is_some_and(|at| now >= at);
                hrtim_common::isr::DLLRDY.put(word, u32::from(ready))
            }
            hrtim_common::oenr::ADDRESS => {
                u32::from(self.enabled[0]) | u32::from(self.enabled[1]) << 1
            }
            hrtim_tima::cntar::ADDRESS => self.a.count(self.frozen_at.unwrap_or(now)),
            hrtim_timb::cntr::ADDRESS => self.b.count(self.frozen_at.unwrap_or(now)),
            _ => word,
        }
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        file: &mut RegisterFile,
        log: &mut Log,
    ) -> u32 {
        let now = log.now;
        let before = file.word(address);
        match address {
            hrtim_common::dllcr::ADDRESS => {
                if value & (hrtim_common::dllcr::CAL.mask() | hrtim_common::dllcr::CALEN.mask())
                    != 0
                {
                    self.dll_ready_at.get_or_insert(now + DLL_CALIBRATION);
                }
                value
            }
            hrtim_common::icr::ADDRESS => {
                let flags = file.word(hrtim_common::isr::ADDRESS) & !(value & 0x7F);
                file.set_word(hrtim_common::isr::ADDRESS, flags);
                0
            }
            hrtim_common::oenr::ADDRESS => {
                self.enable(value, file, log);
                0
            }
            hrtim_common::odisr::ADDRESS => {
                let outputs = [value & OUTPUT_1 == 0, value & OUTPUT_2 == 0];
                let left = [self.enabled[0] && outputs[0], self.enabled[1] && outputs[1]];
                if left == [false; 2] {
                    self.switch_off(now);
                }
                self.enabled = left;
                0
            }
            hrtim_common::cr2::ADDRESS => {
                self.software_update(value, file, log);
                0
            }
            hrtim_master::mcr::ADDRESS => {
                self.start_counters(value, file, log);
                value
            }
            hrtim_tima::perar::ADDRESS
            | hrtim_tima::cmp1ar::ADDRESS
            | hrtim_timb::perbr::ADDRESS
            | hrtim_timb::cmp3br::ADDRESS => {
                // RM0440, 27.3.4, table "Timer period and compare min and max values": prescaler 2.
                if !(0x60..=0xFFDF).contains(&value) {
                    log.broken(format!(
                        "HRTIM period or compare {value:#x} outside 0x60 to 0xFFDF (RM0440 27.3.4)"
                    ));
                }
                value
            }
            hrtim_tima::dtar::ADDRESS => self.dead_time_written(before, value, file, log),
            hrtim_common::fltinr1::ADDRESS => self.fault_input_written(before, value, log),
            hrtim_common::fltinr2::ADDRESS => sources_written(before, value, file, log),
            hrtim_tima::fltar::ADDRESS if before & hrtim_tima::fltar::FLTLCK.mask() != 0 => {
                if value != before {
                    log.broken("HRTIM FLTAR written after FLTLCK (RM0440 27.5.29)");
                }
                before
            }
            hrtim_tima::timacr::ADDRESS | hrtim_timb::timbcr::ADDRESS => {
                check_mode(value, log);
                value
            }
            _ => value,
        }
    }

    /// Applies a stored write: without preload the register is active at once.
    pub fn after_write(&mut self, address: u32, file: &RegisterFile) {
        for (timer, preload) in [
            (0, hrtim_tima::timacr::PREEN),
            (1, hrtim_timb::timbcr::PREEN),
        ] {
            if PRELOADED[timer].contains(&address) && !file.is(preload) {
                self.update(timer, file);
            }
        }
    }

    /// Handles a write to HRTIM_CR2: updates registers and resets counters.
    fn software_update(&mut self, value: u32, file: &RegisterFile, log: &mut Log) {
        use hrtim_common::cr2::{TARST, TASWU, TBRST, TBSWU};
        let now = log.now;
        let lower_closed = self.a.count(now) > self.in_force(0, hrtim_tima::cmp1ar::ADDRESS);
        if TARST.extract(value) == 1
            && self.a.running
            && lower_closed
            && matches!(self.bridge(file), Bridge::Switching { .. })
        {
            log.broken(
                "HRTIM counter reset in mid-period: output 1 is set by the period event, which a reset is not, so the \
                 lower switch stays closed for up to 1.5 periods (RM0440 27.3.6)",
            );
        }
        for (timer, update, reset) in [(0, TASWU, TARST), (1, TBSWU, TBRST)] {
            if update.extract(value) == 1 {
                // The counter continues from its present count.
                let count = self.counter(timer).count(now);
                self.counter(timer).started = now - Ticks::from(count);
                self.update(timer, file);
            }
            if reset.extract(value) == 1 {
                self.counter(timer).started = now;
            }
        }
    }

    fn start_counters(&mut self, value: u32, file: &RegisterFile, log: &mut Log) {
        use hrtim_master::mcr::{TACEN, TBCEN};
        let ready = self.dll_ready_at.is_some_and(|at| log.now >= at);
        for (timer, enable, mode) in [
            (0, TACEN, hrtim_tima::timacr::ADDRESS),
            (1, TBCEN, hrtim_timb::timbcr::ADDRESS),
        ] {
            let counter = self.counter(timer);
            let on = enable.extract(value) == 1;
            if on && !counter.running {
                if !ready {
                    log.broken("HRTIM counter enabled before the DLL is ready (RM0440 27.3.22)");
                }
                check_mode(file.word(mode), log);
                counter.started = log.now;
            }
            counter.running = on;
        }
    }
}

/// Checks TIMxCR, whose fields lie at the same bits for both timers: prescaler and counting mode.
fn check_mode(control: u32, log: &mut Log) {
    use hrtim_tima::timacr::{CK_PSCX, CONT};
    if CK_PSCX.extract(control) != 2 {
        log.broken("HRTIM: this emulator counts at prescaler 2 only");
    }
    if CONT.extract(control) == 0 {
        log.broken("HRTIM: a timer without CONT stops after one period (RM0440 27.3.4)");
    }
}
