//! `ihd record`: everything that a device streams, in a capture file; by the daemon if it has the device.

#[cfg(feature = "daemon")]
mod by_daemon;
mod direct;
mod trigger;

use std::path::PathBuf;
use std::time::Duration;

use anyhow::Result;
use clap::Args;
use ihd_capture::recording::{RecordSettings, Trigger};
use ihd_link::{Client, DeviceSpec, Transport};
use ihd_sim::hob::SimHob;
use ihd_sim::transport::SharedHob;

use self::direct::DirectRecording;
#[cfg(feature = "daemon")]
use super::device::Hob;
use super::global::Global;
use super::recording_file;
use super::simulate::quantity::{power_w, quantity, time_s};
use super::simulated::SimulatedHobArgs;
use super::usage::Usage;

/// Time limit for an ended file to be complete, or for the reason of a failure.
const COMPLETE_WITHIN: Duration = Duration::from_secs(10);

/// Half-cycles per window without --windows-every.
const WINDOWS_EVERY: u8 = 20;

/// Record what a device streams: telemetry, windows of samples, faults, and the link byte for byte.
///
/// The file (docs/captures.md) is readable whenever the recorder ends, a kill included. A device that the daemon has is recorded by
/// the daemon, with its store's options, into its folder `recordings`; --out downloads the file.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd record --device usb --power 1000 --out kitchen.mcap\n  \
    ihd record --device bench --trigger 'level:power>1000' --pre-trigger 5 --duration 30\n  \
    ihd record --device sim --power 1500 --duration 5s --out hob.mcap\n  \
    ihd record --device tcp:127.0.0.1:4711 --max-size 100M --out long.mcap --json\n\n\
    Exit codes: 0 recorded (a limit or ^C ended it), 1 failed or the trigger did not come, 2 wrong usage, 3 device or link, 4 recorded, but it did not heat with --power")]
pub struct RecordArgs {
    /// The device: a name of the configuration, sim, tcp:HOST:PORT, usb, usb:SERIAL or serial:PATH
    #[arg(long, value_name = "DEVICE", default_value = "sim")]
    device: String,
    /// The capture file; an existing one is never overwritten
    #[arg(long, short, value_name = "FILE", value_parser = recording_file::parse)]
    out: Option<PathBuf>,
    /// End this long after the beginning, in s: after the trigger, which is waited for without a limit
    #[arg(long, value_name = "S", value_parser = time_s)]
    duration: Option<f64>,
    /// End when the file has this size in bytes (10M)
    #[arg(long, value_name = "BYTES", value_parser = quantity)]
    max_size: Option<f64>,
    /// Trigger: now, fault, or a level that is crossed, as level:power>1000 (W), level:current>40 (A), level:resistance<2 (ohm),
    /// level:inductance<25 (µH), level:frequency<30 (kHz)
    #[arg(long, value_name = "EVENT", default_value = "now", value_parser = trigger::trigger)]
    trigger: Trigger,
    /// Record what came in this time before the trigger too, in s, up to 60
    #[arg(long, value_name = "S", default_value = "0", value_parser = time_s)]
    pre_trigger: f64,
    /// Request this power in watt meanwhile; without it the device's power is not changed
    #[arg(long, value_name = "W", value_parser = power_w)]
    power: Option<u16>,
    /// A telemetry every so many half-cycles; 0 for none [default: 1]
    #[arg(long, value_name = "N")]
    telemetry_every: Option<u8>,
    /// A window of samples every so many half-cycles; 0 for none. A window of 57 kB takes 14
    /// half-cycles on a link of 400 kB/s, what is due sooner is dropped and counted [default: 20]
    #[arg(long, value_name = "N")]
    windows_every: Option<u8>,
    #[command(flatten)]
    simulated: SimulatedHobArgs,
}

/// Error of a recording that was ended before its trigger.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the trigger did not come: nothing was recorded")]
struct NothingRecorded;

impl RecordArgs {
    /// Connects, records and prints the report.
    ///
    /// # Errors
    /// If the device or the file fails; the data recorded until then are in the file.
    pub fn run(&self, global: &Global) -> Result<()> {
        self.check()?;
        if matches!(self.device.parse(), Ok(DeviceSpec::Sim)) {
            return self.simulated(global.json);
        }
        self.of_device(global)
    }

    fn check(&self) -> Result<()> {
        let positive = |x: Option<f64>| x.is_none_or(|x| x.is_finite() && x > 0.0);
        ensure_usage!(positive(self.duration), "--duration must be more than 0 s");
        ensure_usage!(positive(self.max_size), "--max-size must be more than 0");
        self.settings().check().map_err(Usage)?;
        Ok(())
    }

    /// Records a simulated hob of this process.
    fn simulated(&self, json: bool) -> Result<()> {
        let Some(out) = &self.out else {
            return Err(Usage(
                "--out FILE: a simulated hob's capture has no name of its own".into(),
            )
            .into());
        };
        self.ensure_trigger_for_before()?;
        let config = self.simulated.config()?;
        let sim = || -> Box<dyn Transport> { Box::new(SharedHob::new(SimHob::new(&config))) };
        let client = Client::connect(DeviceSpec::Sim.open(sim)?)?;
        self.direct(out.clone(), true, json).run(client)
    }

    fn direct(&self, out: PathBuf, simulated: bool, json: bool) -> DirectRecording {
        DirectRecording {
            out,
            settings: self.settings(),
            power: self.power,
            telemetry_every: self.telemetry_every.unwrap_or(1),
            windows_every: self.windows_every.unwrap_or(WINDOWS_EVERY),
            simulated,
            json,
        }
    }

    fn settings(&self) -> RecordSettings {
        RecordSettings {
            trigger: self.trigger,
            pre_trigger_s: self.pre_trigger,
            duration_s: self.duration,
            max_bytes: self.max_size.map(|bytes| bytes.ceil() as u64),
        }
    }

    /// Refuses a pre-trigger of a recording that begins with the connection.
    fn ensure_trigger_for_before(&self) -> Result<()> {
        ensure_usage!(
            self.trigger != Trigger::Now || self.pre_trigger == 0.0,
            "without a daemon there is no data from before: --pre-trigger needs --trigger, or `ihd trainer --daemon`"
        );
        Ok(())
    }

    /// Records a device of the configuration, or at an address.
    #[cfg(feature = "daemon")]
    fn of_device(&self, global: &Global) -> Result<()> {
        let config = super::configured::config(global.config.as_deref())?;
        let (out, json) = (self.out.as_deref(), global.json);
        match Hob::find(config, &self.device)? {
            Hob::Daemon { client, name } => {
                self.ensure_plain()?;
                by_daemon::record(&client, &name, out, &self.settings(), json)
            }
            Hob::Direct(device) => {
                self.ensure_trigger_for_before()?;
                let out = self.out.clone();
                let out = out.unwrap_or_else(|| direct::file_of(device.name()));
                self.direct(out, false, json).run(device.into_client())
            }
        }
    }

    /// Refuses the options that only a recording by this process has.
    #[cfg(feature = "daemon")]
    fn ensure_plain(&self) -> Result<()> {
        let given = [
            ("--power", self.power.is_some()),
            ("--telemetry-every", self.telemetry_every.is_some()),
            ("--windows-every", self.windows_every.is_some()),
        ];
        match given.iter().find(|(_, is_given)| *is_given) {
            None => Ok(()),
            Some((flag, _)) => Err(Usage(format!(
                "{flag} does not go with a recording by the daemon; `ihd device DEV power` heats"
            ))
            .into()),
        }
    }

    /// Records a device at an address.
    #[cfg(not(feature = "daemon"))]
    fn of_device(&self, global: &Global) -> Result<()> {
        let spec: DeviceSpec = self.device.parse().map_err(Usage::from_error)?;
        let Some(out) = &self.out else {
            return Err(Usage("--out FILE: where the capture goes".into()).into());
        };
        self.ensure_trigger_for_before()?;
        let client = Client::connect(spec.open(|| unreachable!("no simulated hob"))?)?;
        self.direct(out.clone(), false, global.json).run(client)
    }
}
