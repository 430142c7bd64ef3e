//! The pot's base warms up, and R and L drift with it over minutes.

/// Heat capacity of base and lower wall with the food that heats at once, in J/K.
const HEAT_CAPACITY_J_PER_K: f64 = 900.0;

/// Heat passed on to the food and the room, in W/K.
const COOLING_W_PER_K: f64 = 14.0;

/// Room temperature in °C.
const ROOM_C: f64 = 20.0;

/// One lumped temperature: C dT/dt = P − G (T − room). At 2 kW it settles 143 K above the room with
/// a time constant of 64 s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalModel {
    temperature_c: f64,
}

impl Default for ThermalModel {
    /// At room temperature.
    fn default() -> Self {
        Self {
            temperature_c: ROOM_C,
        }
    }
}

impl ThermalModel {
    /// Temperature in °C.
    pub fn temperature_c(&self) -> f64 {
        self.temperature_c
    }

    /// Heats with `power_w` for `dt_s`, short against the time constant.
    pub fn advance(&mut self, power_w: f64, dt_s: f64) {
        let flow_w = power_w - COOLING_W_PER_K * (self.temperature_c - ROOM_C);
        self.temperature_c += flow_w * dt_s / HEAT_CAPACITY_J_PER_K;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_settles_where_heating_and_cooling_balance() {
        let mut w = ThermalModel::default();
        let tau_s = HEAT_CAPACITY_J_PER_K / COOLING_W_PER_K;
        (0..(tau_s * 100.0) as u32).for_each(|_| w.advance(2000.0, 0.01));
        let rise = 2000.0 / COOLING_W_PER_K * (1.0 - (-1f64).exp());
        assert!((w.temperature_c() - ROOM_C - rise).abs() < 0.1);
    }
}
