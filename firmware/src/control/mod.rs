//! Control: the hob's state machine, in the thread: figures of each half-cycle, steps after each block.
//!
//! | state | entered by | left when |
//! |---|---|---|
//! | Idle | start; 0 W | power is requested and a start is permitted: Probing |
//! | Probing | a request of power | a pot probe, before the first crest: Heating with a pot, else WaitingForPot |
//! | Heating | a pot that can be heated | two half-cycles in a row without one: WaitingForPot |
//! | WaitingForPot | no pot, or one that cannot be heated | a probe finds one: Heating; after a time without one: Idle |
//! | Pausing | a trip, or a mains that is not as it must be | its pause is over: Idle, and from there on |
//! | LockedOut | tries used up, or a fault of the controller | a person switches off and on |
//!
//! 0 W leads from Probing, Heating and WaitingForPot to Idle at once; it comes from panel and host
//! ([`request`]), from a host that is silent for 10 s or clears a fault, and from a cooking time that is over ([`cooking_times`]). A fault leads from
//! any state to Pausing or LockedOut, as [`restart`] decides, which every start passes too. In
//! Heating the bridge is off between bursts ([`burst`]), and while a second zone has the supply ([`supply_share`]).
//!
//! ```text
//! half-cycle ─► plausibility ─► heating: pot, burst or power ─► Action ─► sampling path
//! buttons ─► panel ──┬► request ► │
//! host ──────────────┘            │
//! sensors ─► temperature, pot heat ► │
//! ```
//!
//! [`controller::Control`] takes one half-cycle and answers with an [`status::Action`]. The frequency of a new
//! drive is searched in steps, one after each block ([`controller::Control::advance`]), and found within the
//! half-cycle. It takes effect at the next zero crossing: a half-cycle of another frequency is of the
//! past for power control, but shows the pot.

pub mod burst;
mod bus_ripple;
pub mod controller;
pub mod cooking_times;
pub mod heating;
pub mod panel;
pub mod parts;
pub mod plausibility;
pub mod pot;
pub mod pot_heat;
pub mod pot_watch;
pub mod power;
pub mod request;
pub mod restart;
pub mod share_wire;
pub mod status;
pub mod supply_share;
pub mod temperature;
pub mod unattended;
pub mod waiting;
