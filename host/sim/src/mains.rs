//! The rectified mains behind the half-bridge's bus.

/// 230 V mains, rectified, with no bus capacitance to speak of: the bus follows |sin|.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mains {
    /// Mains frequency in hertz, 50 or 60.
    pub frequency_hz: f64,
    /// Peak of the bus voltage in volt.
    pub peak_v: f64,
    /// Distortion: third, fifth and seventh harmonic as a share of the fundamental, in phase at
    /// the zero crossing. A positive third or a negative fifth flattens the top.
    pub harmonics: [f64; 3],
}

impl Mains {
    /// Nominal European or American frequency at 230 V.
    pub fn new(frequency_hz: f64) -> Self {
        Self {
            frequency_hz,
            peak_v: ihd_shared::hob::BUS_PEAK_V,
            harmonics: [0.0; 3],
        }
    }

    /// Duration of a half-cycle in seconds.
    pub fn half_cycle_s(&self) -> f64 {
        0.5 / self.frequency_hz
    }

    /// Mains voltage at a time after a rising zero crossing, in volt.
    pub fn mains_v(&self, t_s: f64) -> f64 {
        let angle = std::f64::consts::TAU * self.frequency_hz * t_s;
        let mut v = libm::sin(angle);
        if self.harmonics != [0.0; 3] {
            for (share, order) in self.harmonics.into_iter().zip([3.0, 5.0, 7.0]) {
                v += share * libm::sin(order * angle);
            }
        }
        self.peak_v * v
    }

    /// Rectified mains at a time after a zero crossing, in volt.
    pub fn bus_v(&self, t_s: f64) -> f64 {
        libm::fabs(self.mains_v(t_s))
    }
}
