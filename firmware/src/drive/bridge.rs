//! States of the half-bridge, and the changes between them.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Open | start, off, any fault, replay | power is requested and the tank is at rest: LowerOn |
//! | LowerOn | requested power | first zero crossing after 1 ms: Switching |
//! | Switching | LowerOn | off, fault, replay: Open at once |
//!
//! Off, fault and replay lead from LowerOn to Open as well. A switch closes again from the first
//! zero crossing after both opened: until then the resonance capacitor may follow the mains through a diode. What is left in it
//! after a probe, about a third of a bus that C2 holds up, then flows through coil and lower switch.

use crate::drive::pwm;
use crate::limits::BOOTSTRAP_CHARGE_NS;

/// The two switches of the half-bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bridge {
    /// Both open.
    Open,
    /// The lower one closed: it charges the upper driver's bootstrap capacitor.
    LowerOn,
    /// Both closed in turn, with dead time.
    Switching,
}

/// State and frequency of the half-bridge, from the next block on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drive {
    /// Switching frequency, in hertz; the ADC trigger follows it whatever the bridge does.
    pub f_sw_hz: u32,
    /// The switches.
    pub bridge: Bridge,
}

impl Drive {
    /// Both switches open, sampling at the highest rate.
    pub const OFF: Self = Self {
        f_sw_hz: pwm::MAX_HZ,
        bridge: Bridge::Open,
    };

    /// Heating at a frequency in hertz.
    pub const fn switching(f_sw_hz: u32) -> Self {
        Self {
            f_sw_hz,
            bridge: Bridge::Switching,
        }
    }

    /// Returns `true` if power flows.
    pub fn is_switching(self) -> bool {
        self.bridge == Bridge::Switching
    }

    /// The drive after a block. Both switches open at once; out of open switches the lower one closes, once it
    /// `may_close`; switching begins or changes at a zero crossing. `lower_on_ns` is the time for which only the lower switch
    /// has been closed.
    pub fn next(
        self,
        requested: Self,
        at_crossing: bool,
        lower_on_ns: u32,
        may_close: bool,
    ) -> Self {
        match (self.bridge, requested.bridge) {
            (Bridge::Open, Bridge::Switching) if !may_close => self,
            (Bridge::Open, Bridge::Switching) => Self {
                bridge: Bridge::LowerOn,
                ..self
            },
            (Bridge::LowerOn, Bridge::Switching)
                if !at_crossing || lower_on_ns < BOOTSTRAP_CHARGE_NS =>
            {
                self
            }
            (Bridge::Switching, Bridge::Switching) if !at_crossing => self,
            _ => requested,
        }
    }
}

/// Amplitude of the bridge's fundamental, 2/π of the bus, in microvolt: 4.2e9 at most, 32 bit.
pub fn fundamental_uv(bus_peak_dv: u16) -> u32 {
    u32::from(bus_peak_dv) * 63_662
}
