//! Three thermistors and the chip's reference voltage on ADC4, which does nothing else: the others convert pairs, bus and mains at each trigger, and a fourth
//! channel among those would come between.

use ihd_firmware::control::temperature::TemperatureCodes;
use ihd_firmware::sense::supply::Reference;
use ihd_shared::board::{COIL_NTC_PIN, GLASS_NTC_PIN, HEAT_SINK_NTC_PIN, Pin};

use super::registers::clocks::CORE_MHZ;
use super::registers::{adc, supply};

/// Heat sink, glass, coil, VREFINT (ADC, table "ADC internal channels": input 18, whose sampling takes 4 µs at least).
const CHANNELS: [u8; 4] = [
    channel(HEAT_SINK_NTC_PIN),
    channel(GLASS_NTC_PIN),
    channel(COIL_NTC_PIN),
    18,
];

/// Input of ADC4 at PB12, PB14 or PB15 (DS12288, table "Pin definition").
const fn channel(pin: Pin) -> u8 {
    match pin.line {
        12 => 3,
        14 => 4,
        _ => 5,
    }
}

/// From one conversion to the next: 1 ms, so each is looked at every 4 ms.
const EVERY_CYCLES: u32 = CORE_MHZ * 1_000;

/// Code of a converter that is silent: an open thermistor, which is a fault.
const OPEN: u16 = 4_095;

/// Looks at two conversions of 6 µs before the converter is taken to be silent.
const MAX_POLLS: u32 = 2_000;

/// The converter and what it found.
pub struct TemperatureAdc {
    codes: [u16; 4],
    turn: usize,
    started_at: u32,
}

impl TemperatureAdc {
    /// Starts the converter, and looks at each thermistor once. The clock of ADC3, which is its own too, is set already.
    pub fn start(now: u32) -> Self {
        adc::start_single(&CHANNELS);
        let codes = CHANNELS.map(|channel| {
            adc::convert(channel);
            (0..MAX_POLLS)
                .find_map(|_| adc::converted())
                .unwrap_or(OPEN)
        });
        adc::convert(CHANNELS[0]);
        Self {
            codes,
            turn: 0,
            started_at: now,
        }
    }

    /// Takes what was converted and starts the next, once a millisecond; called after each block, with the cycles of the blocks.
    /// Returns `true` if there is something new.
    pub fn after_block(&mut self, now: u32) -> bool {
        if now.wrapping_sub(self.started_at) < EVERY_CYCLES {
            return false;
        }
        self.started_at = now;
        let code = adc::converted().unwrap_or(OPEN);
        if let Some(place) = self.codes.get_mut(self.turn) {
            *place = code;
        }
        self.turn = (self.turn + 1) % CHANNELS.len();
        if let Some(&channel) = CHANNELS.get(self.turn) {
            adc::convert(channel);
        }
        true
    }

    /// The last codes of heat sink, glass and coil, 0 to 4 095 over 0 to 3.3 V.
    pub fn codes(&self) -> TemperatureCodes {
        let [heat_sink, glass, coil, _] = self.codes;
        TemperatureCodes {
            heat_sink: Some(heat_sink),
            glass: Some(glass),
            coil: Some(coil),
        }
    }

    /// The reference voltage as converted last; a converter that is silent gives the end of the range.
    pub fn reference(&self) -> Reference {
        let [_, _, _, code] = self.codes;
        Reference {
            code,
            calibrated: supply::reference_calibration(),
        }
    }

    /// Returns `true` if the last conversion was the reference's.
    pub fn has_new_reference(&self) -> bool {
        self.turn == 0
    }
}
