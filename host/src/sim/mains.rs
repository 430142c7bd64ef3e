//! The rectified mains behind the half-bridge's bus.

/// 230 V mains, rectified, with no bus capacitance to speak of: the bus follows |sin|.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mains {
    /// Mains frequency in hertz, 50 or 60.
    pub frequency_hz: f64,
    /// Peak of the bus voltage in volt.
    pub peak_v: f64,
}

impl Mains {
    /// Nominal European or American frequency at 230 V.
    pub fn new(frequency_hz: f64) -> Self {
        Self {
            frequency_hz,
            peak_v: ihd_shared::hob::BUS_PEAK_V,
        }
    }

    /// Duration of a half-cycle in seconds.
    pub fn half_cycle_s(&self) -> f64 {
        0.5 / self.frequency_hz
    }

    /// Bus voltage at a time after a zero crossing, in volt.
    pub fn bus_v(&self, t_s: f64) -> f64 {
        self.peak_v * libm::fabs(libm::sin(std::f64::consts::TAU * self.frequency_hz * t_s))
    }
}
