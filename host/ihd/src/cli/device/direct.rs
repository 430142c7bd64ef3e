//! Device without a daemon: the link, with reports in the daemon's form.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use ihd_daemon::config::DaemonConfig;
use ihd_daemon::firmware::{updates_needed, usb_serial};
use ihd_daemon::live::recent_power::RecentPower;
use ihd_daemon::states::{device_state, live_of_status};
use ihd_link::{Client, DeviceEvent};
use ihd_model::{
    Command, CommandReply, DeviceReport, DeviceState, Identity, LookupReport, WindowCounts,
};
use ihd_shared::lookup::RlLookup;
use ihd_shared::wire::messages::{Status, Telemetry};
use ihd_signal::printable;

use super::address::address_of;
use crate::cli::opener::opener;

/// Time limit for an accepted lookup to become active: the next half-cycle, plus the link's latency.
const ACTIVE_WITHIN: Duration = Duration::from_secs(2);

/// Link and its device.
pub(in crate::cli) struct Direct {
    client: Client,
    config: DaemonConfig,
    name: String,
    address: String,
    last: Option<Telemetry>,
    power: RecentPower,
    streams: bool,
}

impl Direct {
    /// Connects.
    pub(super) fn open(mut config: DaemonConfig, address: String, name: &str) -> Result<Self> {
        let open = opener(&mut config)?;
        let place = address_of(&config, &address)?;
        let client = Client::connect(open(&place)?.transport)?;
        Ok(Self {
            client,
            config,
            name: name.to_owned(),
            address: place.to_string(),
            last: None,
            power: RecentPower::default(),
            streams: false,
        })
    }

    pub(in crate::cli) fn name(&self) -> &str {
        &self.name
    }

    pub(super) fn client(&mut self) -> &mut Client {
        &mut self.client
    }

    /// Returns the link.
    pub(in crate::cli) fn into_client(self) -> Client {
        self.client
    }

    /// Sends a request, so that the device continues to heat.
    pub(super) fn keep_alive(&mut self) -> Result<()> {
        self.client.status()?;
        Ok(())
    }

    /// Reads the device's report in the daemon's form.
    pub(super) fn report(&mut self) -> Result<DeviceReport> {
        let status = self.client.status()?;
        self.take_events()?;
        let lookup = self.client.read_lookup().ok();
        let hello = self.client.hello();
        let (state, detail) = state(&status);
        Ok(DeviceReport {
            name: self.name.clone(),
            address: self.address.clone(),
            serial: usb_serial(&self.address).unwrap_or(&self.name).to_owned(),
            updates_needed: updates_needed(hello.protocol_minor),
            state,
            since_s: 0,
            detail,
            identity: Some(Identity {
                build: printable(&hello.build).to_string(),
                board: printable(&hello.board).to_string(),
                protocol: (hello.protocol_major, hello.protocol_minor),
                boot_id: hello.boot_id,
                reset_reason: hello.reset_reason,
            }),
            live: Some(live_of_status(&status, self.last.as_ref(), &self.power)),
            lookup: LookupReport {
                on_device: Some(status.lookup_version),
                active: None,
                pending: None,
                observed_cells: lookup.map_or(0, |lookup| lookup.observed_cells()),
            },
            windows: WindowCounts::default(),
            asked_by_daemon_w: 0,
            lease: None,
            sweep_left_w: Vec::new(),
            sweep_is_complete: false,
            recording: None,
            recording_now: None,
            recording_failure: None,
            pot_temperature: None,
            connections: 1,
            frames_beyond: 0,
        })
    }

    /// Starts or stops the stream of half-cycles, which gives R and L for the reports.
    pub(super) fn stream(&mut self, on: bool) -> Result<()> {
        self.client.stream(u8::from(on), 0)?;
        self.streams = on;
        Ok(())
    }

    fn take_events(&mut self) -> Result<()> {
        while self.streams
            && let Some(event) = self.client.next_event(Duration::ZERO)?
        {
            if let DeviceEvent::Telemetry(telemetry) = event {
                self.power.push(&telemetry, Instant::now().into());
                self.last = Some(telemetry);
            }
        }
        Ok(())
    }

    /// Carries out a command that needs no daemon.
    pub(super) fn command(&mut self, command: &Command) -> Result<CommandReply> {
        let text = match command {
            Command::Power { power_w } => {
                let granted = self.client.set_power(*power_w)?;
                return Ok(CommandReply {
                    granted_w: Some(granted.granted_w),
                    ..CommandReply::with_text(granted.to_string())
                });
            }
            Command::Off => {
                self.client.set_power(0)?;
                "off".into()
            }
            Command::ClearFault => {
                self.client.clear_fault()?;
                "fault cleared".into()
            }
            Command::LookupPush { blob } => self.push(blob)?,
            Command::LookupRollback { version: Some(_) } => {
                return Err(anyhow!(
                    "earlier versions are in the daemon's store: `ihd trainer --daemon`"
                ));
            }
            Command::LookupRollback { version: None } => {
                let lookup = self.before()?;
                self.push(&lookup.to_bytes())?
            }
            Command::LookupReset => {
                self.client.reset_lookup()?;
                "back to the built-in lookup".into()
            }
            Command::Sweep { .. } | Command::RecordStart(_) | Command::RecordStop => {
                return Err(anyhow!("this needs the daemon: `ihd trainer --daemon`"));
            }
        };
        Ok(CommandReply::with_text(text))
    }

    fn push(&mut self, blob: &[u8]) -> Result<String> {
        self.client.push_lookup_bytes(blob)?;
        let version = RlLookup::from_bytes(blob).map(|lookup| lookup.version);
        let until = Instant::now() + ACTIVE_WITHIN;
        while Instant::now() < until {
            let now = self.client.status()?.lookup_version;
            if version.as_ref().is_ok_and(|version| *version == now) {
                return Ok(format!("lookup {now} active"));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Err(anyhow!(
            "{}: it took the lookup, but does not use it within {} s; `lookup show` tells",
            self.name,
            ACTIVE_WITHIN.as_secs()
        ))
    }

    /// Returns the lookup before the active one from the store, under a new version.
    fn before(&mut self) -> Result<RlLookup> {
        let on_device = self.client.status()?.lookup_version;
        let folder = &self.config.store;
        let store = ihd_store::StoreReader::open(folder).context(
            "what was active before stands in the store: give its configuration with --config",
        )?;
        let rows = store.lookups_of(&self.name)?;
        let before = ihd_store::superseded_lookups(&rows, on_device).next();
        let row = before.with_context(|| {
            format!(
                "the store {} holds no lookup of {} that was active before",
                folder.display(),
                self.name
            )
        })?;
        let mut lookup = RlLookup::from_bytes(&row.blob).context("a lookup of the store")?;
        let newest = rows.iter().map(|row| row.version).max().unwrap_or(0);
        lookup.version = newest.max(on_device).saturating_add(1);
        Ok(lookup)
    }
}

/// State and its reason in the daemon's terms, without learning.
fn state(status: &Status) -> (DeviceState, String) {
    let (state, detail) = match device_state(status, DeviceState::Connected) {
        (DeviceState::Learning, detail) => (DeviceState::Connected, detail),
        other => other,
    };
    match detail.as_str() {
        "" => (state, "without a daemon".into()),
        _ => (state, detail),
    }
}
