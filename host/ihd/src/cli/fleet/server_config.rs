//! `ihd fleet server-config`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd_fleet::server_config::{Edge, Server, Site, Tls, read_or_make, server_config};

/// Print a configuration of nats-server in which each edge and worker may do what it must and no more; make the keys that are missing
///
/// Say the same again with one edge more or less, put what is printed in the place of the old one, and send the server SIGHUP
/// (docs/fleet-security.md).
#[derive(Debug, Args)]
#[command(
    after_help = "Example: ihd fleet server-config --site lab --edge lab-1=bench,kitchen --fleet-page lab-1 --workers 2 \\\n           \
    --tls /etc/nats/tls --keys keys > nats.conf"
)]
pub struct ServerConfigArgs {
    /// Name of the site: it has an account of its own
    #[arg(long, value_name = "SITE")]
    site: String,
    /// An edge and its hobs; may be given again
    #[arg(long = "edge", value_name = "EDGE=HOB,…", required = true)]
    edges: Vec<Edge>,
    /// An edge whose dashboard may show the whole fleet; may be given again
    #[arg(long, value_name = "EDGE")]
    fleet_page: Vec<String>,
    /// How many workers: worker-1, worker-2, …
    #[arg(long, value_name = "N", default_value_t = 1)]
    workers: u32,
    /// Folder with certificate.pem and key.pem of the server; without it nothing is encrypted
    #[arg(long, value_name = "DIR")]
    tls: Option<PathBuf>,
    /// Where the server listens
    #[arg(long, value_name = "ADDRESS", default_value = "0.0.0.0:4222")]
    listen: String,
    /// Where the server speaks MQTT; not without (docs/mqtt.md)
    #[arg(long, value_name = "ADDRESS")]
    mqtt: Option<String>,
    /// Folder of JetStream on the server
    #[arg(long, value_name = "DIR", default_value = "/var/lib/nats")]
    store: PathBuf,
    /// Folder of the keys; those that are missing are made
    #[arg(long, value_name = "DIR", default_value = "keys")]
    keys: PathBuf,
}

impl ServerConfigArgs {
    pub(super) fn run(&self) -> Result<()> {
        let mut edges = self.edges.clone();
        for shown in &self.fleet_page {
            let edge = edges.iter_mut().find(|edge| edge.name == *shown);
            ensure_usage!(
                edge.is_some(),
                "--fleet-page {shown:?}: there is no --edge {shown}=…"
            );
            edge.into_iter().for_each(|edge| edge.sees_fleet = true);
        }
        let server = Server {
            name: format!("ihd-{}", self.site),
            listen: self.listen.clone(),
            mqtt_listen: self.mqtt.clone(),
            store: self.store.clone(),
            tls: self.tls.as_ref().map(|folder| Tls {
                certificate: folder.join("certificate.pem"),
                key: folder.join("key.pem"),
            }),
        };
        let site = Site::new(&self.site, edges, self.workers);
        let names = site.key_names(self.mqtt.is_some());
        let keys = read_or_make(&self.keys, names.iter().map(String::as_str))?;
        let text = server_config(&server, &[site], &keys)?;
        crate::cli::output::text(&text)
    }
}
