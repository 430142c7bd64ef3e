//! First switching, from a current-limited bench supply: a few seconds at the lowest power, and checks of the samples.
//!
//! In any case the power is switched off at the end, which is a check of its own.

mod period;
mod window_checks;

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_link::{Client, DeviceEvent, KEEPALIVE_PERIOD, LinkError, Window};
use ihd_shared::fault::Fault;
use ihd_shared::wire::messages::{FrontEnd, Status};
use ihd_survey::calibration::ReferenceLoad;

use crate::Check;
use crate::board::{bus_volt, is_off};
use crate::check_session::CheckSession;

/// Requested power in watt. The highest frequency gives more; hence bursts, which begin there and go down in frequency.
const POWER_W: u16 = 1;

/// Range of bus voltages for this test, in volt. Above 60 V it is dangerous to touch; below 25 V there is no supply.
pub const BUS_V: (f64, f64) = (25.0, 60.0);

/// Error of the bus voltage: 1 % of divider and VDDA, at 60 V.
const MEASURED_TO_V: f64 = 0.6;

/// Bus voltage at which the test ends, in volt; above the range by the crest of ripple and noise.
const MAX_BUS_V: f64 = 66.0;

/// Amplitude of the current at which the test ends, in ampere: at 60 V a pot takes 2.7 A, an aluminium pan 9 A.
const MAX_A: f64 = 5.0;

/// Time limit of switching, and the number of windows that suffice.
const SWITCHES_FOR: Duration = Duration::from_secs(5);
const WINDOWS: usize = 5;

/// Period of the windows in half-cycles: of a burst's few half-cycles, each that the link has time for.
const WINDOW_EVERY: u8 = 1;

/// Time limit for the device to report that it is off.
const OFF_WITHIN: Duration = Duration::from_secs(2);

/// Period of polling for Ctrl-C.
const STOP_POLL_PERIOD: Duration = Duration::from_millis(50);

/// Checks of the samples, in this order; each is in the report in any case.
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

/// Observations while it switched.
#[derive(Debug, Default)]
struct SwitchingRecord {
    windows: Vec<Window>,
    /// Highest bus voltage of the last half-cycle that reported one, in volt.
    bus_v: f64,
    /// Largest amplitude of the current, in ampere.
    i_a: f64,
    /// Reason for the early end; `None` if there was none.
    ended_by: Option<String>,
}

/// Switches on, checks the samples and switches off. `reference` is the load, if known; `stop` ends the test early. The second
/// result is the reason for an early end if the link was lost.
pub fn run(
    client: &mut Client,
    reference: Option<ReferenceLoad>,
    stop: &AtomicBool,
) -> (Vec<Check>, Option<String>) {
    let scales = client.front_end().clone();
    let mut session = CheckSession::new(client);
    let before = session.check_answer("bench_supply", |client| {
        let status = client.status()?;
        Ok((status, client.channels()?))
    });
    let Some((status, channels)) = before else {
        return not_tested_from(session, 1, "the bus was not measured");
    };
    let supply = bench_supply(&status, bus_volt(&channels, &scales));
    let may_switch = supply.verdict == crate::CheckResult::Pass;
    session.add(supply);
    if !may_switch {
        return not_tested_from(session, 1, "nothing was switched on");
    }
    let mut seen = SwitchingRecord::default();
    let switched = session.check_answer("switching", |client| switch(client, stop, &mut seen));
    if switched.is_some() {
        session.add(window_checks::switching(&seen));
    }
    session.check_always(power_off);
    // The window at the highest frequency: its samples are closest together.
    match seen.windows.iter().max_by_key(|window| window.f_sw_hz) {
        Some(window) => {
            for check in window_checks::window(window, &scales, seen.bus_v, reference) {
                session.add(check);
            }
            session.finish()
        }
        None => not_tested_from(session, 3, "no window of samples came"),
    }
}

/// Adds all checks from `from` on as not tested.
fn not_tested_from(
    mut session: CheckSession<'_>,
    from: usize,
    why: &str,
) -> (Vec<Check>, Option<String>) {
    for name in NAMES.into_iter().skip(from) {
        session.add(Check::not_tested(name, why));
    }
    session.finish()
}

/// Checks that this bus may be switched.
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
            "24 V~ on L and N make the zero crossings (docs/bring-up.md, E); clear what stays: ihd device DEV clear-fault",
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

/// Switches on and collects events until they suffice.
fn switch(
    client: &mut Client,
    stop: &AtomicBool,
    seen: &mut SwitchingRecord,
) -> Result<(), LinkError> {
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
        if client.clock().saturating_sub(heard) >= KEEPALIVE_PERIOD {
            heard = client.clock();
            client.status()?;
        }
        seen.take(client.next_event(STOP_POLL_PERIOD)?);
        if seen.ended_by.is_some() {
            break;
        }
    }
    Ok(())
}

impl SwitchingRecord {
    fn take(&mut self, event: Option<DeviceEvent>) {
        match event {
            Some(DeviceEvent::Window(window)) => self.windows.push(*window),
            Some(DeviceEvent::Telemetry(t)) => {
                if t.bus_peak_dv > 0 {
                    self.bus_v = f64::from(t.bus_peak_dv) * 0.1;
                }
                self.i_a = self.i_a.max(f64::from(t.i_crest_ma) * 1e-3);
                if self.bus_v > MAX_BUS_V {
                    self.ended_by = Some(format!("the bus rose to {:.1} V", self.bus_v));
                } else if self.i_a > MAX_A {
                    self.ended_by = Some(format!("the coil's current rose to {:.1} A", self.i_a));
                }
            }
            Some(DeviceEvent::Fault(event)) if event.fault != Fault::NONE => {
                self.ended_by = Some(event.fault.to_string());
            }
            _ => {}
        }
    }
}

/// Switches off and checks that the device is off. Tried even if the link was lost.
fn power_off(client: &mut Client) -> Check {
    const NAME: &str = "power_off";
    const REMEDY: &str = "Switch the supply off. The device switches off by itself 10 s after it last heard of a host";
    let off = client.set_power(0);
    // An error of the stream is ignored: switching off matters more.
    let _ = client.stream(0, 0);
    if let Err(error) = off {
        return Check::fail(NAME, format!("the request failed: {error}"), REMEDY);
    }
    let begin = client.clock();
    loop {
        match client.status() {
            Ok(status) if is_off(&status) => {
                return Check::pass(NAME, "the device reports that it is off");
            }
            Ok(status) if client.clock().saturating_sub(begin) > OFF_WITHIN => {
                let finding = format!("after the request it is {:?}", status.state);
                return Check::fail(NAME, finding, REMEDY);
            }
            Ok(_) => {
                // Lets time pass on the device's clock.
                let _ = client.next_event(STOP_POLL_PERIOD);
            }
            Err(error) => {
                return Check::fail(NAME, format!("after the request: {error}"), REMEDY);
            }
        }
    }
}

/// Volt per code of bus and coil.
fn code_v(scales: &FrontEnd) -> (f64, f64) {
    let scales = scales.scales();
    (scales.volt_per_code(), scales.ampere_per_code())
}
