//! First switching, from a current-limited bench supply: a few seconds of the least power, and what the samples show.
//!
//! Whatever happens, power is asked off at the end, and that is a check of its own.

mod period;
mod shown;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_link::{Client, Event, HEARD_EVERY, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{FrontEnd, Status};
use ihd_survey::calibration::Reference;

use crate::Check;
use crate::asking::Asking;
use crate::board::{bus_volt, is_off};

/// What is asked for, in watt. It is less than the highest frequency gives, where any load is harmless: bursts of that.
const POWER_W: u16 = 1;

/// Bus voltages at which this is done, in volt. Above 60 V it is dangerous to touch; below 25 V there is no supply.
pub const BUS_V: (f64, f64) = (25.0, 60.0);

/// What a bus voltage is measured to: 1 % of its divider and of VDDA, as far as it matters at 60 V.
const MEASURED_TO_V: f64 = 0.6;

/// Bus voltage at which it ends, in volt: a crest of ripple and noise above what it began with is none.
const MOST_BUS_V: f64 = 66.0;

/// Amplitude of the current at which it ends, in ampere: at 60 V a pot takes 2.7 A, an aluminium pan 9.
const MOST_A: f64 = 5.0;

/// How long it may switch, and what is enough.
const SWITCHES_FOR: Duration = Duration::from_secs(5);
const WINDOWS: usize = 5;

/// A window every so many half-cycles: of a burst's few, each that the link has time for.
const WINDOW_EVERY: u8 = 1;

/// How long the device may take to show that it is off.
const OFF_WITHIN: Duration = Duration::from_secs(2);

/// Between two looks at ^C.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// What is made of the samples, in this order; each check is there whatever comes of it.
pub const NAMES: [&str; 9] = [
    "bench_supply",
    "switching",
    "power_off",
    "edges",
    "coil_against_bus",
    "offsets",
    "load",
    "resonance",
    "skew",
];

/// What was seen while it switched.
#[derive(Debug, Default)]
struct Seen {
    windows: Vec<Window>,
    /// Highest bus voltage of the last half-cycle that told one, in volt.
    bus_v: f64,
    /// Largest amplitude of the current, in ampere.
    i_a: f64,
    /// Why it ended early.
    ended_by: Option<String>,
}

/// Switches, looks and switches off. `reference` is the load, where something is known of it. `stop` ends it early.
/// Also says why it ended before its end, where the link was lost.
pub fn run(
    client: &mut Client,
    reference: Option<Reference>,
    stop: &AtomicBool,
) -> (Vec<Check>, Option<String>) {
    let scales = client.front_end().clone();
    let mut asking = Asking::of(client);
    let before = asking.ask("bench_supply", |client| {
        let status = client.status()?;
        Ok((status, client.channels()?))
    });
    let Some((status, channels)) = before else {
        return rest(asking, 1, "the bus was not measured");
    };
    let supply = bench_supply(&status, bus_volt(&channels, &scales));
    let may_switch = supply.verdict == crate::Verdict::Pass;
    asking.add(supply);
    if !may_switch {
        return rest(asking, 1, "nothing was switched on");
    }
    let mut seen = Seen::default();
    let switched = asking.ask("switching", |client| switch(client, stop, &mut seen));
    if switched.is_some() {
        asking.add(shown::switching(&seen));
    }
    asking.always(power_off);
    // That of the highest frequency: its samples lie closest.
    match seen.windows.iter().max_by_key(|window| window.f_sw_hz) {
        Some(window) => {
            for check in shown::window(window, &scales, seen.bus_v, reference) {
                asking.add(check);
            }
            asking.end()
        }
        None => rest(asking, 3, "no window of samples came"),
    }
}

/// Every check from `from` on is not tested.
fn rest(mut asking: Asking<'_>, from: usize, why: &str) -> (Vec<Check>, Option<String>) {
    for name in NAMES.into_iter().skip(from) {
        asking.add(Check::not_tested(name, why));
    }
    asking.end()
}

/// Whether this bus may be switched.
fn bench_supply(status: &Status, bus_v: f64) -> Check {
    const NAME: &str = "bench_supply";
    let (least_v, most_v) = BUS_V;
    if !is_off(status) {
        return Check::fail(
            NAME,
            "it heats already",
            "Switch it off: ihd device DEV off",
        );
    }
    if status.fault != Fault::NONE {
        return Check::not_tested(NAME, format!("{} is active", status.fault)).with_remedy(
            "24 V~ on L and N make the zero crossings (docs/first-power-up.md, E); clear what stays: ihd device DEV clear-fault",
        );
    }
    if bus_v > most_v + MEASURED_TO_V {
        return Check::fail(
            NAME,
            format!("{bus_v:.1} V on the bus, more than {most_v:.0} V"),
            "Nothing is switched: take the mains off, wait 5 s, and use a supply of 30 to 60 V with a current limit of 1 A",
        );
    }
    if bus_v < least_v {
        return Check::not_tested(NAME, format!("{bus_v:.1} V on the bus: no supply"))
            .with_remedy("30 to 60 V, limit 1 A, on DC+ and DC−; F1 out, 24 V~ on L and N");
    }
    Check::pass(NAME, format!("{bus_v:.1} V on the bus"))
}

/// Switches on, and takes what comes until it is enough.
fn switch(client: &mut Client, stop: &AtomicBool, seen: &mut Seen) -> Result<(), LinkError> {
    if stop.load(Ordering::Relaxed) {
        seen.ended_by = Some("^C".to_owned());
        return Ok(());
    }
    client.stream(1, WINDOW_EVERY)?;
    client.set_power(POWER_W)?;
    let begin = client.clock();
    let mut heard = begin;
    while client.clock().saturating_sub(begin) < SWITCHES_FOR && seen.windows.len() < WINDOWS {
        if stop.load(Ordering::Relaxed) {
            seen.ended_by = Some("^C".to_owned());
            break;
        }
        if client.clock().saturating_sub(heard) >= HEARD_EVERY {
            heard = client.clock();
            client.status()?;
        }
        seen.take(client.next_event(LOOK_EVERY)?);
        if seen.ended_by.is_some() {
            break;
        }
    }
    Ok(())
}

impl Seen {
    fn take(&mut self, event: Option<Event>) {
        match event {
            Some(Event::Window(window)) => self.windows.push(*window),
            Some(Event::Telemetry(t)) => {
                if t.bus_peak_dv > 0 {
                    self.bus_v = f64::from(t.bus_peak_dv) * 0.1;
                }
                self.i_a = self.i_a.max(f64::from(t.i_crest_ma) * 1e-3);
                if self.bus_v > MOST_BUS_V {
                    self.ended_by = Some(format!("the bus rose to {:.1} V", self.bus_v));
                } else if self.i_a > MOST_A {
                    self.ended_by = Some(format!("the coil's current rose to {:.1} A", self.i_a));
                }
            }
            Some(Event::Fault(event)) if event.fault != Fault::NONE => {
                self.ended_by = Some(event.fault.to_string());
            }
            _ => {}
        }
    }
}

/// Switches off, and looks whether it is. Tried whatever was lost before.
fn power_off(client: &mut Client) -> Check {
    const NAME: &str = "power_off";
    const REMEDY: &str = "Switch the supply off. The device switches off by itself 10 s after it last heard of a host";
    let off = client.set_power(0);
    // Whatever becomes of the stream, the power is what counts.
    let _ = client.stream(0, 0);
    if let Err(error) = off {
        return Check::fail(NAME, format!("it was not told: {error}"), REMEDY);
    }
    let begin = client.clock();
    loop {
        match client.status() {
            Ok(status) if is_off(&status) => {
                return Check::pass(NAME, "it is off, by its own word");
            }
            Ok(status) if client.clock().saturating_sub(begin) > OFF_WITHIN => {
                let finding = format!("it was told, and is {:?}", status.state);
                return Check::fail(NAME, finding, REMEDY);
            }
            Ok(_) => {
                // Lets time pass on the device's clock.
                let _ = client.next_event(LOOK_EVERY);
            }
            Err(error) => {
                return Check::fail(NAME, format!("it was told, and then: {error}"), REMEDY);
            }
        }
    }
}

/// What the codes of the device's bus and coil stand for, in what `shown` needs of it.
fn code_v(scales: &FrontEnd) -> (f64, f64) {
    let scales = scales.scales();
    (scales.volt_per_code(), scales.ampere_per_code())
}
