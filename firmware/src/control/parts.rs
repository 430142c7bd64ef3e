//! Parts of control that outlive a state: requests, restart policy, temperatures, power control, and the pot.

use ihd_shared::fault::Fault;
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::wire::messages::{Limit, Pot};

use crate::control::cooking_times::{BELOW_BOOST_W, CookingTimes};
use crate::control::pot_heat::PotHeat;
use crate::control::power::PowerControl;
use crate::control::request::PowerRequest;
use crate::control::restart::RestartPolicy;
use crate::control::supply_share::SupplyShare;
use crate::control::temperature::Temperatures;
use crate::drive::pwm;
use crate::limits::SMALL_POT_PERCENT;
use crate::sense::supply::Supply;

/// Parts that every state reads and changes.
#[derive(Clone, Debug)]
pub struct ControlParts {
    /// Panel and host.
    pub request: PowerRequest,
    /// Tries and pauses.
    pub restart: RestartPolicy,
    /// Time without a touch of the panel, boost and timer.
    pub times: CookingTimes,
    /// Heat sink, glass, coil and fan.
    pub temperatures: Temperatures,
    /// Heat of what stands on the glass.
    pub pot_heat: PotHeat,
    /// The analogue supply.
    pub supply: Supply,
    /// Mains that is shared with a second zone.
    pub supply_share: SupplyShare,
    /// Search for the frequency.
    pub power: PowerControl,
    /// The pot that was judged last.
    pub pot: Pot,
    /// Frequency at which a pot was heated last, in hertz.
    pub heated_hz: u32,
    /// The sensors contradict each other: a change of R or L is theirs, or a fault within some half-cycles.
    pub is_balance_off: bool,
}

impl Default for ControlParts {
    fn default() -> Self {
        Self {
            request: PowerRequest::default(),
            restart: RestartPolicy::default(),
            times: CookingTimes::default(),
            temperatures: Temperatures::default(),
            pot_heat: PotHeat::default(),
            supply: Supply::default(),
            supply_share: SupplyShare::default(),
            power: PowerControl::default(),
            pot: Pot::Unknown,
            heated_hz: pwm::MAX_HZ,
            is_balance_off: false,
        }
    }
}

impl ControlParts {
    /// The condition that forbids heating for as long as it lasts, by its fault.
    pub fn condition(&self) -> Fault {
        match self.supply.fault() {
            Fault::NONE => self.temperatures.fault(),
            fault => fault,
        }
    }

    /// Granted part of the requested power, in watt, and the limit that holds it below.
    pub fn granted_w(&self) -> (u16, Limit) {
        let (asked_w, most) = (self.request.power_w(), self.most_w());
        if asked_w > most.0 {
            most
        } else {
            (asked_w, Limit::None)
        }
    }

    /// Highest power that can be granted, in watt, and the limit that it is.
    pub fn most_w(&self) -> (u16, Limit) {
        let percent = |share: u16| (u32::from(RATED_POWER_W) * u32::from(share) / 100) as u16;
        let is_small = self.pot == Pot::Small;
        let mut most = (RATED_POWER_W, Limit::None);
        for (holds, most_w, limit) in [
            (
                true,
                percent(self.temperatures.power_percent()),
                Limit::Temperature,
            ),
            (true, self.pot_heat.power_w(), Limit::Temperature),
            (is_small, percent(SMALL_POT_PERCENT), Limit::SmallPot),
            (
                self.request.keeps_warm(),
                self.pot_heat.warm_w(),
                Limit::KeepWarm,
            ),
            (self.times.boost.is_over(), BELOW_BOOST_W, Limit::Boost),
        ] {
            if holds && most.0 > most_w {
                most = (most_w, limit);
            }
        }
        most
    }
}
