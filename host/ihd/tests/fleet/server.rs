//! A NATS server of the test: started, killed, stopped, restarted with its data.

use std::fs::{self, File};
use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use tempfile::TempDir;

use super::site::{PATIENCE, until};

/// Environment variable with another program than that of `cargo xtask test --only setup`.
pub const PROGRAM: &str = "IHD_NATS_SERVER";

/// Period of polling in a wait.
const POLL_PERIOD: Duration = Duration::from_millis(5);

/// Address and folder of a server, for its configuration.
pub struct ServerLocation {
    /// Its own address of the loopback. No other process has the port, and a client that reconnects while the server is
    /// down never gets the server's port as its source port.
    pub address: Ipv4Addr,
    /// Its folder: configuration, store, log, certificates.
    pub folder: PathBuf,
}

impl ServerLocation {
    /// Returns the value of `listen:`: this address and any free port.
    pub fn any_port(&self) -> String {
        format!("\"{}:-1\"", self.address)
    }

    /// Returns the first lines of every configuration here: address, and JetStream with synchronous writes and a limit that does
    /// not depend on the free space of this machine's disk.
    pub fn basics(&self) -> String {
        let (listen, store) = (self.any_port(), self.folder.join("store"));
        format!(
            "server_name: ihd-test\nlisten: {listen}\n\
             jetstream {{ store_dir: {store:?}, sync_interval: always, max_file_store: 12GB }}\n"
        )
    }
}

/// The server, which does not outlive its owner.
pub struct Server {
    child: Child,
    /// Holds everything, and goes with the server.
    folder: TempDir,
    address: Ipv4Addr,
    port: u16,
    mqtt_port: Option<u16>,
    /// Starts so far: each has a log of its own.
    starts: usize,
}

impl Server {
    /// Starts a server without users, with `more` lines of configuration (`mqtt { listen: … }`, `accounts { … }`).
    pub fn start(more: &str) -> Self {
        Self::configured(|place| place.basics() + more)
    }

    /// Starts a server with the configuration that `write` returns for its place.
    pub fn configured(write: impl FnOnce(&ServerLocation) -> String) -> Self {
        let folder = tempfile::Builder::new().prefix("ihd-nats-").tempdir();
        let folder = folder.expect("a folder for the server");
        let address = own_address();
        let place = ServerLocation {
            address,
            folder: folder.path().to_owned(),
        };
        fs::write(folder.path().join("nats.conf"), write(&place)).expect("its configuration");
        let child = spawn(folder.path(), 1).expect("nats-server starts");
        let mut server = Self {
            child,
            folder,
            address,
            port: 0,
            mqtt_port: None,
            starts: 1,
        };
        server.wait_until_ready();
        server.port = server.port_of_file("nats");
        server.mqtt_port = server.mqtt_port_of_log();
        server
    }

    /// Returns its URL, `nats://127.x.y.z:port`.
    pub fn url(&self) -> String {
        format!("nats://{}", self.address())
    }

    /// Returns the address for clients of NATS.
    pub fn address(&self) -> SocketAddr {
        (self.address, self.port).into()
    }

    /// Returns the address for clients of MQTT.
    pub fn mqtt_address(&self) -> SocketAddr {
        let port = self.mqtt_port.expect("a configuration with mqtt");
        (self.address, port).into()
    }

    /// Returns its process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Returns its folder: `nats.conf`, `store/`, and the files of its configuration.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Returns its log since the last start.
    pub fn log(&self) -> String {
        fs::read_to_string(log_file(self.folder(), self.starts)).unwrap_or_default()
    }

    /// Kills it (`kill -9`), as a power failure would, and waits for its end.
    pub fn kill9(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Restarts it at the same address with the same store; kills it first if it runs.
    pub fn restart(&mut self) {
        self.kill9();
        // The former port, in place of any free port; the client's comes first in every configuration here.
        let any = format!("{}:-1", self.address);
        self.rewrite(|text| text.replacen(&any, &self.address().to_string(), 1));
        self.starts += 1;
        self.child = spawn(self.folder.path(), self.starts).expect("nats-server starts again");
        self.wait_until_ready();
    }

    /// Changes its configuration file, for [`Server::reload`] or [`Server::restart`].
    pub fn rewrite(&self, change: impl FnOnce(String) -> String) {
        let file = self.folder().join("nats.conf");
        let text = fs::read_to_string(&file).expect("its configuration");
        fs::write(file, change(text)).expect("its configuration");
    }

    /// Reloads its configuration (SIGHUP) and waits for the result.
    ///
    /// # Errors
    /// Its log line if it refuses the configuration.
    pub fn reload(&self) -> Result<(), String> {
        let before = self.log().len();
        self.signal("HUP");
        let deadline = Instant::now() + PATIENCE;
        loop {
            let log = self.log();
            let since = log.get(before..).unwrap_or_default();
            if since.contains("Reloaded server configuration") {
                return Ok(());
            }
            if let Some(line) = since.lines().find(|l| l.contains("Failed to reload")) {
                return Err(line.to_owned());
            }
            assert!(Instant::now() < deadline, "no word of a reload:\n{log}");
            thread::sleep(POLL_PERIOD);
        }
    }

    /// Suspends its process (SIGSTOP) and waits until all its threads stand still: connections stay, nothing is answered.
    pub fn freeze(&self) {
        self.signal("STOP");
        until("a server that stands still", PATIENCE, || {
            self.stands_still()
        });
    }

    /// Returns `true` if each of its threads is stopped (proc(5): state T after the name in brackets).
    fn stands_still(&self) -> bool {
        let threads = fs::read_dir(format!("/proc/{}/task", self.pid())).expect("a server");
        threads.flatten().all(|thread| {
            let state = fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
            let after_name = state.rsplit_once(") ").map(|(_, rest)| rest);
            after_name.is_some_and(|rest| rest.starts_with('T'))
        })
    }

    /// Ends [`Server::freeze`].
    pub fn thaw(&self) {
        self.signal("CONT");
    }

    fn signal(&self, name: &str) {
        let mut kill = Command::new("kill");
        kill.arg(format!("-{name}")).arg(self.pid().to_string());
        let sent = kill.status().is_ok_and(|status| status.success());
        assert!(sent, "no server to send {name} to:\n{}", self.log());
    }

    fn wait_until_ready(&mut self) {
        let deadline = Instant::now() + PATIENCE;
        while !self.log().contains("Server is ready") {
            if let Some(status) = self.child.try_wait().expect("a child of ours") {
                let errors = fs::read_to_string(self.folder().join("stderr")).unwrap_or_default();
                panic!("nats-server ended ({status}): {errors}\n{}", self.log());
            }
            assert!(Instant::now() < deadline, "not ready:\n{}", self.log());
            thread::sleep(POLL_PERIOD);
        }
    }

    /// Returns its monitoring port, for a configuration with `http`.
    pub fn monitoring_port(&self) -> u16 {
        self.port_of_file("monitoring")
    }

    /// Returns a port that it chose, from its file of ports.
    fn port_of_file(&self, of: &str) -> u16 {
        let end = format!("_{}.ports", self.pid());
        let deadline = Instant::now() + PATIENCE;
        loop {
            // The file's name begins with the program's name, which may differ.
            let files = fs::read_dir(self.folder().join("ports")).expect("its folder");
            let mut files = files.flatten().map(|file| file.path());
            let file = files.find(|file| file.to_string_lossy().ends_with(&end));
            let text = file.and_then(|file| fs::read_to_string(file).ok());
            let port = text.and_then(|text| {
                let urls = serde_json::from_str::<serde_json::Value>(&text).ok()?;
                let url = urls[of][0].as_str()?.to_owned();
                url.rsplit(':').next()?.parse().ok()
            });
            if let Some(port) = port {
                return port;
            }
            assert!(Instant::now() < deadline, "no port:\n{}", self.log());
            thread::sleep(POLL_PERIOD);
        }
    }

    /// Returns the port of MQTT, which stands only in the log.
    fn mqtt_port_of_log(&self) -> Option<u16> {
        let log = self.log();
        let line = log.lines().find(|l| l.contains("for MQTT clients on"))?;
        line.rsplit(':').next()?.trim().parse().ok()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if thread::panicking() {
            eprintln!("the server's log:\n{}", self.log());
        }
        self.kill9();
    }
}

/// Returns the program: `IHD_NATS_SERVER`, else that of `cargo xtask test --only setup` beside the build, else one on the PATH.
pub fn program() -> PathBuf {
    if let Some(named) = std::env::var_os(PROGRAM) {
        return named.into();
    }
    // The test's own program lies in target/debug/deps.
    let build = std::env::current_exe().unwrap_or_default();
    let beside = build
        .ancestors()
        .nth(3)
        .map(|target| target.join("tools/nats/bin/nats-server"));
    beside
        .filter(|program| program.is_file())
        .unwrap_or_else(|| "nats-server".into())
}

fn spawn(folder: &Path, start: usize) -> io::Result<Child> {
    let ports = folder.join("ports");
    fs::create_dir_all(&ports)?;
    let mut command = Command::new(program());
    command
        .arg("--config")
        .arg(folder.join("nats.conf"))
        .arg("--ports_file_dir")
        .arg(ports)
        .arg("--log")
        .arg(log_file(folder, start))
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(folder.join("stderr"))?);
    command.spawn().map_err(|why| {
        let what = format!(
            "{:?} does not start ({why}): `cargo xtask test --only setup` brings it, or name one in {PROGRAM}",
            program()
        );
        io::Error::new(why.kind(), what)
    })
}

fn log_file(folder: &Path, start: usize) -> PathBuf {
    folder.join(format!("log-{start}"))
}

/// Returns an address of the loopback that no other server of this machine's tests has.
fn own_address() -> Ipv4Addr {
    static NEXT: AtomicU8 = AtomicU8::new(2);
    let [_, _, high, low] = std::process::id().to_be_bytes();
    Ipv4Addr::new(127, high, low, NEXT.fetch_add(1, Relaxed))
}
