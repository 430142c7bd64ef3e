//! ADC1 to 4: start-up sequence, regular conversions triggered by HRTIM or software (RM0440, 21).

use crate::registers::{Field, adc1, adc2, adc3, adc4, adc12_common, adc345_common};
use crate::time::{TICKS_PER_S, Ticks, us};
use crate::violation::Log;

use super::register_file::RegisterFile;

/// Start-up time of the voltage regulator (DS12288, table "ADC characteristics": t_ADCVREG_STUP).
const REGULATOR_START: Ticks = us(20);

/// Duration of the calibration in cycles of the ADC's clock (DS12288: t_CAL, 1 / f_ADC each).
const CALIBRATION_CYCLES: u64 = 112;

/// Highest clock of the ADC in range 1 (DS12288: f_ADC, all ADCs in single-ended mode 60 MHz).
const F_ADC_MAX_HZ: u64 = 60_000_000;

/// ADC clock cycles between the calibration's end and ADEN (RM0440, 21.4.8).
const AFTER_CALIBRATION_CYCLES: u64 = 4;

/// Latency of a trigger in cycles of the ADC's clock at CKMODE = HCLK/4 (DS12288: t_LATR).
const TRIGGER_LATENCY_CYCLES: f64 = 2.125;

/// Conversion time at 12 bit without sampling, in cycles (RM0440, 21.4.15).
const CONVERSION_CYCLES: f64 = 12.5;

/// Sampling times of SMPx in cycles (RM0440, 21.7.6).
const SAMPLING_CYCLES: [f64; 8] = [2.5, 6.5, 12.5, 24.5, 47.5, 92.5, 247.5, 640.5];

/// Time after a conversion or the calibration beyond which the result of the next may be wrong (ES0430 2.7.7).
const IDLE_MAX: Ticks = us(1_000);

/// External trigger 21 of every ADC: hrtim_adc_trg1 (RM0440, tables 163 and 164).
const HRTIM_TRIGGER_1: u32 = 21;

/// One converter: addresses of its registers and state of its conversion.
#[derive(Clone, Debug)]
pub struct Converter {
    base: u32,
    name: &'static str,
    common_clock: Field,
    regulator_at: Option<Ticks>,
    calibrated_at: Option<Ticks>,
    calibrating_until: Ticks,
    enabled_at: Option<Ticks>,
    /// End of the current conversion; `rank` is the place of the next one in the sequence.
    busy_until: Ticks,
    rank: u32,
    /// State of the conversion under way, and of the data register: begun after [`IDLE_MAX`].
    is_late: bool,
    is_data_late: bool,
    /// Number of conversions of each channel since the last reset.
    pub taken: [u32; 19],
}

impl Converter {
    /// Converter by its number from 0: ADC1, 2, 3 or 4.
    pub fn new(number: usize) -> Self {
        let (base, name, common_clock) = [
            (adc1::BASE, "ADC1", adc12_common::ccr::CKMODE),
            (adc2::BASE, "ADC2", adc12_common::ccr::CKMODE),
            (adc3::BASE, "ADC3", adc345_common::ccr::CKMODE),
            (adc4::BASE, "ADC4", adc345_common::ccr::CKMODE),
        ][number];
        Self {
            base,
            name,
            common_clock,
            regulator_at: None,
            calibrated_at: None,
            calibrating_until: 0,
            enabled_at: None,
            busy_until: 0,
            rank: 0,
            is_late: false,
            is_data_late: false,
            taken: [0; 19],
        }
    }

    /// Field of this converter that corresponds to a field of ADC1.
    fn field(&self, of_adc1: Field) -> Field {
        of_adc1.at(of_adc1.address - adc1::BASE + self.base)
    }

    fn get(&self, field: Field, file: &RegisterFile) -> u32 {
        file.get(self.field(field))
    }

    /// Clock in hertz: HCLK over 1, 2 or 4 if synchronous, HCLK if CKMODE selects the asynchronous clock.
    fn clock_hz(&self, hclk_hz: u64, file: &RegisterFile) -> u64 {
        match file.get(self.common_clock) {
            1 => hclk_hz,
            2 => hclk_hz / 2,
            3 => hclk_hz / 4,
            // Asynchronous: this image selects the system clock in CCIPR.ADCxSEL and leaves it undivided in PRESC.
            _ => hclk_hz,
        }
    }

    fn ticks(&self, cycles: f64, hclk_hz: u64, file: &RegisterFile) -> Ticks {
        (cycles * TICKS_PER_S as f64 / self.clock_hz(hclk_hz, file).max(1) as f64).round() as Ticks
    }

    /// Reads a register whose content is computed. Reading DR clears EOC (RM0440 21.7.1).
    pub fn read(&self, address: u32, file: &mut RegisterFile, log: &mut Log) -> u32 {
        let (word, now) = (file.word(address), log.now);
        match address - self.base {
            0x00 => {
                let ready = self.enabled_at.is_some_and(|at| now >= at + us(1));
                if ready { word | 1 } else { word & !1 }
            }
            0x40 => {
                if self.is_data_late {
                    self.refuse_late(log);
                }
                file.set(self.field(adc1::isr::EOC), 0);
                word
            }
            0x08 if now < self.calibrating_until => word,
            0x08 => adc1::cr::ADCAL.put(word, 0),
            _ => word,
        }
    }

    /// Handles a write before it is stored; returns the word to store.
    pub fn write(
        &mut self,
        address: u32,
        value: u32,
        hclk_hz: u64,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        let before = file.word(address);
        match address - self.base {
            // ISR: cleared by writing 1.
            0x00 => before & !value,
            0x08 => self.control(before, value, hclk_hz, file, log),
            // CFGR, SMPR, SQR, OFR: "only when ADSTART = 0".
            0x0C | 0x10 | 0x14 | 0x18 | 0x30..=0x3C | 0x60..=0x6C
                if self.get(adc1::cr::ADSTART, file) == 1 =>
            {
                if value != before {
                    log.broken(format!(
                        "{} configured while ADSTART is 1 (RM0440 21.4.10)",
                        self.name
                    ));
                }
                before
            }
            _ => value,
        }
    }

    fn control(
        &mut self,
        before: u32,
        value: u32,
        hclk_hz: u64,
        file: &RegisterFile,
        log: &mut Log,
    ) -> u32 {
        use adc1::cr::{ADCAL, ADEN, ADSTART, ADVREGEN, DEEPPWD};
        let name = self.name;
        let rises = |field: Field| field.extract(value) == 1 && field.extract(before) == 0;
        let now = log.now;
        if rises(ADVREGEN) {
            if DEEPPWD.extract(before) == 1 && DEEPPWD.extract(value) == 1 {
                log.broken(format!(
                    "{name}: ADVREGEN set in deep-power-down (RM0440 21.4.6)"
                ));
            }
            if DEEPPWD.extract(before) == 1 && DEEPPWD.extract(value) == 0 {
                log.broken(format!(
                    "{name}: DEEPPWD cleared and ADVREGEN set by one write; the HAL leaves deep-power-down first \
                     (RM0440 21.4.6; HAL_ADC_Init)"
                ));
            }
            self.regulator_at = Some(now);
        }
        if ADVREGEN.extract(value) == 0 {
            (self.regulator_at, self.calibrated_at, self.enabled_at) = (None, None, None);
        }
        if rises(ADCAL) {
            let clock = self.clock_hz(hclk_hz, file);
            if clock > F_ADC_MAX_HZ {
                log.broken(format!(
                    "{name} calibrated at {clock} Hz, above 60 MHz (DS12288; CKMODE before ADCAL)"
                ));
            }
            if self
                .regulator_at
                .is_none_or(|at| now < at + REGULATOR_START)
            {
                log.broken(format!(
                    "{name} calibrated before its regulator is up, 20 µs (RM0440 21.4.6)"
                ));
            }
            if ADEN.extract(before) == 1 {
                log.broken(format!("{name} calibrated while enabled (RM0440 21.4.8)"));
            }
            self.calibrating_until = now + self.ticks(CALIBRATION_CYCLES as f64, hclk_hz, file);
            self.calibrated_at = Some(self.calibrating_until);
        } else if now < self.calibrating_until && value != before {
            log.broken(format!(
                "{name} CR written during the calibration (RM0440 21.4.8)"
            ));
        }
        if rises(ADEN) {
            let wait = self.ticks(AFTER_CALIBRATION_CYCLES as f64, hclk_hz, file);
            match self.calibrated_at {
                None => log.broken(format!(
                    "{name} enabled without calibration (RM0440 21.4.8)"
                )),
                Some(at) if now < at + wait => {
                    log.broken(format!(
                        "{name} enabled within 4 clocks of its calibration (RM0440 21.4.9)"
                    ));
                }
                Some(_) => {}
            }
            self.enabled_at = Some(now);
        }
        if rises(ADSTART) {
            if self.enabled_at.is_none_or(|at| now < at + us(1)) {
                log.broken(format!("{name} started before ADRDY (RM0440 21.4.9)"));
            }
            self.rank = 0;
        }
        // Hardware clears ADCAL: `read` computes it.
        value
    }

    /// Counts [`IDLE_MAX`] from now on.
    pub fn begin_idle(&mut self, now: Ticks) {
        self.busy_until = self.busy_until.max(now);
    }

    fn refuse_late(&self, log: &mut Log) {
        log.broken(format!(
            "{}: a conversion more than 1 ms after the last one, or after the calibration, is used (ES0430 2.7.7)",
            self.name
        ));
    }

    /// Ends a conversion of a sequence that software started; returns `true` if the next one follows. The last one clears ADSTART
    /// (RM0440 21.4.17); a result that nobody has read is overwritten only with OVRMOD (21.4.26).
    pub fn finish(&mut self, value: u32, file: &mut RegisterFile) -> bool {
        let unread = file.is(self.field(adc1::isr::EOC));
        if !unread || file.is(self.field(adc1::cfgr::OVRMOD)) {
            file.set_word(self.base + 0x40, value);
            self.is_data_late = self.is_late;
        }
        if unread {
            file.set(self.field(adc1::isr::OVR), 1);
        }
        file.set(self.field(adc1::isr::EOC), 1);
        if self.rank > 0 {
            return true;
        }
        file.set(self.field(adc1::isr::EOS), 1);
        file.set(self.field(adc1::cr::ADSTART), 0);
        false
    }

    /// Ends a conversion that a trigger started, with OVRMOD = 1; returns `true` if the DMA is asked to move the result. A result that
    /// was not read by then is lost, and the DMA is asked no more until software clears OVR (RM0440, "ADC overrun", "Managing conversions
    /// using the DMA").
    pub fn requests_transfer(&self, value: u32, file: &mut RegisterFile) -> bool {
        if self.get(adc1::isr::EOC, file) == 1 {
            file.set(self.field(adc1::isr::OVR), 1);
        }
        file.set_word(self.base + 0x40, value & 0xFFFF);
        file.set(self.field(adc1::isr::EOC), 1);
        self.get(adc1::isr::OVR, file) == 0
    }

    /// Notes that the DMA has read the result, which clears EOC.
    pub fn was_read(&self, file: &mut RegisterFile) {
        file.set(self.field(adc1::isr::EOC), 0);
    }

    /// Returns `true` if HRTIM's first trigger starts a conversion now.
    pub fn takes_trigger(&self, file: &RegisterFile) -> bool {
        self.get(adc1::cr::ADSTART, file) == 1
            && self.get(adc1::cfgr::EXTEN, file) == 1
            && self.get(adc1::cfgr::EXTSEL, file) == HRTIM_TRIGGER_1
    }

    /// Starts a conversion on a trigger; returns its channel and its end, `None` if the converter is busy.
    pub fn trigger(
        &mut self,
        hclk_hz: u64,
        file: &RegisterFile,
        log: &mut Log,
    ) -> Option<(u32, Ticks)> {
        if self.enabled_at.is_none_or(|at| log.now < at + us(1)) {
            log.broken(format!(
                "{}: a trigger came before ADRDY (RM0440 21.4.9)",
                self.name
            ));
        }
        if log.now < self.busy_until {
            log.broken(format!(
                "{}: a trigger came before the last conversion had ended (RM0440 21.4.19)",
                self.name
            ));
            return None;
        }
        let length = self.get(adc1::sqr1::L, file) + 1;
        let channel = match self.rank {
            0 => self.get(adc1::sqr1::SQ1, file),
            1 => self.get(adc1::sqr1::SQ2, file),
            2 => self.get(adc1::sqr1::SQ3, file),
            _ => self.get(adc1::sqr1::SQ4, file),
        };
        let by_trigger = self.get(adc1::cfgr::EXTEN, file) != 0;
        if by_trigger && length > 1 && self.get(adc1::cfgr::DISCEN, file) == 0 {
            log.broken(format!(
                "{}: this emulator converts one channel a trigger",
                self.name
            ));
        }
        self.is_late = log.now > self.busy_until.max(self.calibrating_until) + IDLE_MAX;
        // The DMA moves each result.
        if self.is_late && by_trigger {
            self.refuse_late(log);
        }
        self.rank = (self.rank + 1) % length;
        if let Some(taken) = self.taken.get_mut(channel as usize) {
            *taken += 1;
        }
        let cycles =
            TRIGGER_LATENCY_CYCLES + self.sampling_cycles(channel, file) + CONVERSION_CYCLES;
        self.busy_until = log.now + self.ticks(cycles, hclk_hz, file);
        Some((channel, self.busy_until))
    }

    /// Time from a trigger to the end of sampling, when the input is held.
    pub fn hold_delay(&self, hclk_hz: u64, file: &RegisterFile) -> Ticks {
        let channel = self.get(adc1::sqr1::SQ1, file);
        let cycles = TRIGGER_LATENCY_CYCLES + self.sampling_cycles(channel, file);
        self.ticks(cycles, hclk_hz, file)
    }

    fn sampling_cycles(&self, channel: u32, file: &RegisterFile) -> f64 {
        let (register, place) = if channel < 10 {
            (0x14, channel)
        } else {
            (0x18, channel - 10)
        };
        let smp = file.word(self.base + register) >> (3 * place) & 7;
        SAMPLING_CYCLES[smp as usize]
    }

    /// Content of the data register for a 12-bit code from 0 to 4095; an offset makes it signed (RM0440, 21.4.25).
    pub fn data(&self, channel: u32, code: u32, file: &RegisterFile) -> u32 {
        for k in 0..4 {
            let word = file.word(self.base + 0x60 + 4 * k);
            let on = adc1::ofr1::OFFSET1_EN.extract(word) == 1;
            if on && adc1::ofr1::OFFSET1_CH.extract(word) == channel {
                let offset = adc1::ofr1::OFFSET1.extract(word);
                return code.wrapping_sub(offset) & 0xFFFF;
            }
        }
        code
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HCLK_HZ: u64 = 170_000_000;

    fn start(ckmode_first: bool, one_write: bool) -> Vec<String> {
        let (mut file, mut log, mut adc) =
            (RegisterFile::default(), Log::default(), Converter::new(0));
        if ckmode_first {
            file.set(adc12_common::ccr::CKMODE, 3);
        }
        let mut write = |value: u32, log: &mut Log, file: &mut RegisterFile| {
            let stored = adc.write(adc1::cr::ADDRESS, value, HCLK_HZ, file, log);
            file.set_word(adc1::cr::ADDRESS, stored);
            log.now += us(25);
            let read = adc.read(adc1::cr::ADDRESS, &mut *file, log);
            file.set_word(adc1::cr::ADDRESS, read);
        };
        if !one_write {
            write(0, &mut log, &mut file);
        }
        let regulator = adc1::cr::ADVREGEN.mask();
        write(regulator, &mut log, &mut file);
        write(regulator | adc1::cr::ADCAL.mask(), &mut log, &mut file);
        write(regulator | 1, &mut log, &mut file);
        log.violations
            .into_iter()
            .map(|violation| violation.rule)
            .collect()
    }

    #[test]
    fn the_manuals_start_up_passes_and_each_omission_is_found() {
        assert_eq!(start(true, false), Vec::<String>::new());
        assert!(start(false, false)[0].contains("above 60 MHz"));
        assert!(start(true, true)[0].contains("DEEPPWD"));
    }
}
