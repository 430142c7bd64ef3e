//! Conversions of ADC1 to 4: their triggers, their inputs, and the way of their results.

use super::{ADC4, Chip, Conversion, clocks};
use crate::registers as reg;

/// DMAMUX requests of ADC1 and ADC3 (RM0440, table 91).
const REQUEST_ADC1: u32 = 5;
const REQUEST_ADC3: u32 = 37;

impl Chip {
    /// Ends a conversion of ADC1 or ADC3 whose result the DMA moves.
    pub(super) fn move_result(&mut self, request: u32, value: u32) {
        use reg::adc12_common::{ccr, cdr};
        let (file, log) = (&mut self.file, &mut self.log);
        // For pairs MDMA = 2; DMACFG = 1 asks again after the ring's end.
        let (adc, from, is_asked) = match request {
            REQUEST_ADC1 => {
                let is_asked = file.get(ccr::MDMA) == 2 && file.is(ccr::DMACFG);
                (&self.adcs[0], cdr::ADDRESS, is_asked)
            }
            _ => {
                let is_asked = file.is(reg::adc3::cfgr::DMACFG);
                (&self.adcs[2], reg::adc3::dr::ADDRESS, is_asked)
            }
        };
        if !adc.requests_transfer(value, file) {
            return;
        }
        if !is_asked {
            log.broken(
                "ADC with a ring, but without MDMA or DMACFG (RM0440, \"Managing conversions using the DMA\")",
            );
            return;
        }
        if request == REQUEST_ADC3 && self.late_transfers > 0 {
            self.late_transfers -= 1;
            return;
        }
        if let Some(moved) = self.dma.request(request, from, value, file, log) {
            adc.was_read(file);
            self.transfers.push(moved);
        }
    }

    /// Handles HRTIM's first trigger: advances the power stage to this time and starts the conversions.
    pub(super) fn trigger(&mut self) {
        let hclk_hz = clocks::hclk_hz(&self.file);
        self.drive_pins();
        self.set_comparators();
        let hold_delay_s = self.hold_delay_s();
        self.pins.plant.set_hold_delay(hold_delay_s);
        let (sample, tripped) = self.pins.sample();
        self.trip(tripped);
        if self.loses_triggers {
            self.trigger_is_lost = !self.trigger_is_lost;
        }
        if self.loses_triggers && self.trigger_is_lost {
            self.next_trigger = self.hrtim.next_trigger(&self.file, self.log.now);
            return;
        }
        let [adc1, adc2, adc3, _] = &mut self.adcs;
        if adc1.takes_trigger(&self.file)
            && reg::adc12_common::ccr::DUAL.extract(self.file.word(reg::adc12_common::ccr::ADDRESS))
                == 6
        {
            if adc1.hold_delay(hclk_hz, &self.file) != adc2.hold_delay(hclk_hz, &self.file) {
                self.log.broken(
                    "ADC1 and ADC2 sample a pair for different times (RM0440, \"Dual ADC modes\")",
                );
            }
            let voltage = adc1.trigger(hclk_hz, &self.file, &mut self.log);
            let current = adc2.trigger(hclk_hz, &self.file, &mut self.log);
            if let (Some((v_channel, at)), Some((i_channel, _))) = (voltage, current) {
                let low = adc1.data(v_channel, sample.code(1, v_channel), &self.file);
                let high = adc2.data(i_channel, sample.code(2, i_channel), &self.file);
                self.conversions.push(Conversion {
                    at,
                    request: Some(REQUEST_ADC1),
                    value: high << 16 | low,
                });
            }
        }
        if adc3.takes_trigger(&self.file)
            && let Some((channel, at)) = adc3.trigger(hclk_hz, &self.file, &mut self.log)
        {
            let value = adc3.data(channel, sample.code(3, channel), &self.file);
            if self.file.is(reg::adc3::cfgr::DMAEN) {
                self.conversions.push(Conversion {
                    at,
                    request: Some(REQUEST_ADC3),
                    value,
                });
            }
        }
        self.next_trigger = self.hrtim.next_trigger(&self.file, self.log.now);
    }

    /// Time from the begin of a sampling period, which the bridge's is locked to, to the hold of both channels, in seconds. The
    /// trigger waits for an edge of the ADCs' clock besides, up to 24 ns, which is not modelled.
    pub fn hold_delay_s(&self) -> f64 {
        let hclk_hz = clocks::hclk_hz(&self.file);
        let in_adc = self.adcs[0].hold_delay(hclk_hz, &self.file);
        crate::time::seconds(self.hrtim.trigger_delay() + in_adc)
    }

    /// Number of conversions of each channel of an ADC since the last reset; ADCs are numbered from 0.
    pub fn conversions(&self, adc: usize) -> [u32; 19] {
        self.adcs[adc].taken
    }

    /// Starts ADC4 by software, or the next conversion of its sequence: the level at its pin is sampled at once.
    pub(super) fn start_adc4(&mut self) {
        let hclk_hz = clocks::hclk_hz(&self.file);
        let adc = &mut self.adcs[ADC4];
        if let Some((channel, at)) = adc.trigger(hclk_hz, &self.file, &mut self.log) {
            let code = match channel {
                // VREFINT, if it is connected (RM0440, ADCx_CCR).
                18 if self.file.is(reg::adc345_common::ccr::VREFEN) => self.pins.reference_code(),
                _ => self.pins.thermistor_code(channel),
            };
            let value = adc.data(channel, code, &self.file);
            self.conversions.push(Conversion {
                at,
                request: None,
                value,
            });
        }
    }
}
