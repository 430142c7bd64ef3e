//! Opener of a configuration's devices: links to boards, and simulated hobs, which persist between connections.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use ihd_daemon::config::{Address, DaemonConfig};
use ihd_daemon::{OpenDevice, OpenedDevice, TruthFn};
use ihd_link::{DeviceSpec, Transport};
use ihd_sim::hob::{HobConfig, SimHob};
use ihd_sim::transport::{PacedHob, SharedHob};

use super::keys;
use super::simulated::SimOptions;
use super::usage::Usage;

/// Simulated hob of a configuration: the options of `ihd hob`, and `speed`.
#[derive(Clone, Debug)]
struct SimulatedHob {
    hob: HobConfig,
    /// Speed as a multiple of real time.
    speed: f64,
}

impl Default for SimulatedHob {
    fn default() -> Self {
        Self {
            hob: HobConfig::default(),
            speed: 1.0,
        }
    }
}

impl SimulatedHob {
    fn from_table(table: &toml::Table) -> Result<Self> {
        let mut pairs = Vec::new();
        let mut speed = 1.0;
        for (key, value) in table {
            match (key.as_str(), value) {
                ("speed", toml::Value::Float(x)) => speed = *x,
                ("speed", toml::Value::Integer(n)) => speed = *n as f64,
                (_, toml::Value::Boolean(is)) => pairs.push(format!("{key}={is}")),
                (_, toml::Value::String(text)) => pairs.push(format!("{key}={text}")),
                (_, toml::Value::Integer(n)) => pairs.push(format!("{key}={n}")),
                (_, toml::Value::Float(x)) => pairs.push(format!("{key}={x}")),
                _ => bail!(Usage(format!("sim: {key} = {value} is no option"))),
            }
        }
        ensure_usage!(
            speed.is_finite() && speed > 0.0 && speed <= 100.0,
            "sim: speed = {speed}, but must lie between 0 and 100"
        );
        // Names, values and messages of the options are those of the command line.
        let options: SimOptions = keys::parse("sim:", &pairs)?;
        Ok(Self {
            hob: options.config()?,
            speed,
        })
    }
}

/// Key that marks a simulated hob's options with the device's name: no two devices share one.
const NAME: &str = "name";

/// Returns an opener of the configuration's devices. The options of simulated hobs are checked here, before anything runs, and
/// marked in `config`.
///
/// # Errors
/// For an invalid option, with the names of device and option.
pub fn opener(config: &mut DaemonConfig) -> Result<Arc<OpenDevice>> {
    let mut hobs: BTreeMap<String, SimulatedHob> = BTreeMap::new();
    for device in &mut config.devices {
        if device.address.spec == DeviceSpec::Sim {
            let simulated = SimulatedHob::from_table(&device.address.sim)
                .with_context(|| format!("device {:?}", device.name))?;
            let name = device.name.clone();
            let options = &mut device.address.sim;
            options.insert(NAME.to_owned(), toml::Value::String(name.clone()));
            hobs.insert(name, simulated);
        }
    }
    let running: Mutex<BTreeMap<String, SharedHob>> = Mutex::default();
    Ok(Arc::new(move |address: &Address| {
        let mut truth: Option<Arc<TruthFn>> = None;
        let transport = address.spec.open(|| {
            let name = match address.sim.get(NAME) {
                Some(toml::Value::String(name)) => name.clone(),
                _ => String::new(),
            };
            let simulated = hobs.get(&name).cloned().unwrap_or_default();
            let mut running = running.lock().unwrap_or_else(PoisonError::into_inner);
            let hob = running
                .entry(name)
                .or_insert_with(|| SharedHob::new(SimHob::new(&simulated.hob.with_unique_boot())));
            let knows = hob.clone();
            truth = Some(Arc::new(move |half_cycle| knows.truth(half_cycle)));
            Box::new(PacedHob::new(hob.clone(), simulated.speed)) as Box<dyn Transport>
        })?;
        Ok(OpenedDevice { transport, truth })
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(sim: &str) -> DaemonConfig {
        let text = format!(
            "[[device]]\nname = \"a\"\naddress = \"sim\"\n{sim}\n\
             [[device]]\nname = \"b\"\naddress = \"sim\"\n"
        );
        DaemonConfig::parse(&text, "ihd.toml").unwrap()
    }

    #[test]
    fn options_are_those_of_the_command_line() {
        let table =
            "sim = { pot = \"aluminium\", warming = true, mains = 60, snr = 50.5, speed = 2 }";
        let config = config(table);
        let simulated = SimulatedHob::from_table(&config.devices[0].address.sim).unwrap();
        assert_eq!(simulated.hob.mains_hz, 60.0);
        assert!(simulated.hob.warming);
        assert_eq!(simulated.speed, 2.0);
    }

    #[test]
    fn what_is_no_option_is_named() {
        for (sim, words) in [
            ("sim = { pots = \"none\" }", ["\"a\"", "pots"]),
            ("sim = { pot = \"copper\" }", ["\"a\"", "copper"]),
            ("sim = { mains = 16.7 }", ["\"a\"", "mains"]),
            ("sim = { speed = 0 }", ["\"a\"", "speed"]),
            ("sim = { pot = [1] }", ["\"a\"", "pot"]),
        ] {
            let error = opener(&mut config(sim)).err().unwrap();
            let error = super::super::message(&error);
            for word in words {
                assert!(error.contains(word), "{sim}: {error}");
            }
        }
    }
}
