//! A daemon of one hob without a hob, and a server in front of it.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use ihd_api::backend::{Alive, Answer, Backend, Figure};
use ihd_api::model::{StoredLookup, StoredResult};
use ihd_api::{Server, Settings};
use ihd_daemon::model::{
    Command, CommandError, DeviceReport, DeviceState, Done, Lease, LookupReport, Notice,
    WindowCounts,
};
use tokio::runtime::Runtime;
use tokio::sync::{broadcast, watch};

/// The only device, whose name a path cannot hold as it is.
pub const NAME: &str = "serial:/dev/tty ä";

/// What was asked for, and who has the lease.
#[derive(Default)]
pub struct Asked {
    pub commands: Vec<(String, Command)>,
    pub lease: Option<String>,
    pub backups: Vec<PathBuf>,
    pub results: Vec<(u32, Option<i64>)>,
    pub store_dead: bool,
}

#[derive(Clone)]
pub struct Fake {
    pub asked: Arc<Mutex<Asked>>,
    pub notices: broadcast::Sender<Arc<Notice>>,
}

impl Fake {
    pub fn new() -> Self {
        Self {
            asked: Arc::default(),
            notices: broadcast::channel(64).0,
        }
    }

    fn known(device: &str) -> Result<(), CommandError> {
        if device == NAME {
            Ok(())
        } else {
            Err(CommandError::NoDevice {
                name: device.into(),
            })
        }
    }

    fn leased(&self, holder: &str) -> Result<(), CommandError> {
        match &self.asked.lock().unwrap().lease {
            Some(other) if other != holder => Err(CommandError::Leased {
                name: NAME.into(),
                holder: other.clone(),
                expires_in_s: 7,
            }),
            _ => Ok(()),
        }
    }
}

fn report() -> DeviceReport {
    DeviceReport {
        name: NAME.into(),
        address: NAME.into(),
        state: DeviceState::Faulted,
        since_s: 5,
        detail: "a \"fault\"\nin two lines".into(),
        identity: None,
        live: None,
        lookup: LookupReport::default(),
        windows: WindowCounts {
            announced: 12,
            stored: 11,
            lost: 1,
            ..WindowCounts::default()
        },
        asked_by_daemon_w: 0,
        lease: None,
        sweep_left_w: vec![],
        recording: None,
        connections: 3,
    }
}

fn answer<'a, T: Send + 'a>(answer: Result<T, CommandError>) -> Answer<'a, T> {
    Box::pin(async move { answer })
}

impl Backend for Fake {
    fn devices(&self) -> Vec<DeviceReport> {
        vec![report()]
    }

    fn device(&self, name: &str) -> Option<DeviceReport> {
        (name == NAME).then(report)
    }

    fn command<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        command: Command,
    ) -> Answer<'a, Done> {
        let known = Self::known(device).and_then(|()| self.leased(holder));
        answer(known.map(|()| {
            let mut asked = self.asked.lock().unwrap();
            asked.commands.push((holder.into(), command));
            Done {
                text: "done".into(),
                file: None,
            }
        }))
    }

    fn take_lease<'a>(
        &'a self,
        device: &'a str,
        holder: &'a str,
        force: bool,
    ) -> Answer<'a, Lease> {
        let free = if force { Ok(()) } else { self.leased(holder) };
        answer(Self::known(device).and(free).map(|()| {
            self.asked.lock().unwrap().lease = Some(holder.into());
            Lease {
                holder: holder.into(),
                expires_in_s: 10,
            }
        }))
    }

    fn release_lease<'a>(&'a self, device: &'a str, holder: &'a str) -> Answer<'a, ()> {
        let free = Self::known(device).and_then(|()| self.leased(holder));
        answer(free.map(|()| self.asked.lock().unwrap().lease = None))
    }

    fn watch(&self) -> broadcast::Receiver<Arc<Notice>> {
        self.notices.subscribe()
    }

    fn results<'a>(
        &'a self,
        device: &'a str,
        limit: u32,
        since_ms: Option<i64>,
    ) -> Answer<'a, Vec<StoredResult>> {
        self.asked.lock().unwrap().results.push((limit, since_ms));
        answer(Self::known(device).map(|()| vec![]))
    }

    fn lookups<'a>(&'a self, device: &'a str) -> Answer<'a, Vec<StoredLookup>> {
        answer(Self::known(device).map(|()| {
            vec![StoredLookup {
                version: 3,
                state: "active".into(),
                at_ms: 1,
                origin: "host".into(),
                why: String::new(),
                blob: vec![0, 255],
            }]
        }))
    }

    fn backup(&self, to: PathBuf) -> Answer<'_, ()> {
        self.asked.lock().unwrap().backups.push(to);
        answer(Ok(()))
    }

    fn figures(&self) -> Vec<Figure> {
        vec![Figure {
            name: "store_queue",
            help: "Jobs that wait for the store",
            counter: false,
            value: 2.0,
        }]
    }

    fn alive(&self) -> Answer<'_, Alive> {
        answer(Ok(Alive {
            store: !self.asked.lock().unwrap().store_dead,
            supervisor: true,
        }))
    }
}

/// A server that ends with the test.
pub struct Running {
    pub fake: Fake,
    pub address: std::net::SocketAddr,
    pub url: String,
    pub certificate: Option<PathBuf>,
    pub dir: tempfile::TempDir,
    stop: watch::Sender<bool>,
    served: Option<tokio::task::JoinHandle<()>>,
    runtime: Option<Runtime>,
}

impl Running {
    /// On loopback without tokens.
    pub fn start() -> Self {
        Self::with(|_, _| {})
    }

    /// With settings of one's own; the path is a folder for files.
    pub fn with(set: impl FnOnce(&mut Settings, &std::path::Path)) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let mut settings = Settings {
            listen: "127.0.0.1:0".into(),
            allowed_hosts: vec![],
            token_file: None,
            tls: None,
            backups: dir.path().join("backups"),
        };
        set(&mut settings, dir.path());
        let runtime = Runtime::new().unwrap();
        let fake = Fake::new();
        let (stop, stopping) = watch::channel(false);
        let server = runtime.block_on(Server::bind(&settings)).unwrap();
        let (address, url) = (server.address(), server.url());
        let certificate = server.certificate().map(|(_, path)| path.into());
        let served = runtime.spawn(server.run(Arc::new(fake.clone()), stopping));
        Self {
            fake,
            address,
            url,
            certificate,
            dir,
            stop,
            served: Some(served),
            runtime: Some(runtime),
        }
    }

    /// Ends the server, and waits for it.
    pub fn stop(&mut self) {
        self.stop.send(true).unwrap();
        if let (Some(served), Some(runtime)) = (self.served.take(), &self.runtime) {
            runtime.block_on(served).unwrap();
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}
