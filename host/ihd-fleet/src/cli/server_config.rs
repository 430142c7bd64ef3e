//! `ihd-fleet init server-config`.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd::ensure_usage;
use ihd_fleet::server_config::{
    self, EdgeAccount, ServerConfigError, ServerSettings, Site, TlsFiles,
};

/// Print the configuration of a NATS server on which every edge and every worker has a key of its own
///
/// Makes a key for each in the folder of keys, a file a key, for its owner alone; those that are there stay. Who is left out the next time
/// is shut out once the server has read the configuration again (docs/fleet.md).
#[derive(Debug, Args)]
#[command(after_help = "Examples:\n  \
    ihd-fleet init server-config --site lab --edge lab-1=bench,kitchen --workers 2 --tls tls > nats.conf\n  \
    ihd-fleet init server-config --site lab --site field --edge lab/lab-1=bench --edge field/van=hob --mqtt 0.0.0.0:8883 > nats.conf")]
pub struct ServerConfigArgs {
    /// A lab, a plant, a customer: sees nothing of another; may be given again
    #[arg(long = "site", value_name = "SITE", required = true)]
    sites: Vec<String>,
    /// A daemon and its hobs, with its site in front where there are several; may be given again
    #[arg(long = "edge", value_name = "[SITE/]EDGE=HOB,…", value_parser = edge)]
    edges: Vec<(Option<String>, EdgeAccount)>,
    /// An edge that may see who else is in its site's fleet, for the page of its dashboard; may be given again
    #[arg(long = "fleet-page", value_name = "[SITE/]EDGE")]
    fleet_pages: Vec<String>,
    /// Workers of each site, worker-1 and so on: what `ihd-fleet worker --name` says
    #[arg(long, value_name = "N", default_value_t = 1)]
    workers: u32,
    /// Most that each site keeps on the server's disk, in bytes
    #[arg(long, value_name = "BYTES")]
    disk_bytes: Option<u64>,
    /// Folder with certificate.pem and key.pem, as the server sees it; without it everything but the proof of a key is in the clear
    #[arg(long, value_name = "DIR")]
    tls: Option<PathBuf>,
    /// Folder of the keys
    #[arg(long, value_name = "DIR", default_value = "keys")]
    keys: PathBuf,
    /// Folder of the server's data, as the server sees it
    #[arg(long, value_name = "DIR", default_value = "/var/lib/nats")]
    store: PathBuf,
    /// Address to listen on
    #[arg(long, value_name = "ADDRESS", default_value = "0.0.0.0:4222")]
    listen: String,
    /// Address to listen on for MQTT (docs/fleet.md)
    #[arg(long, value_name = "ADDRESS")]
    mqtt: Option<String>,
}

/// Parses `SITE/EDGE=HOB,HOB`.
fn edge(text: &str) -> Result<(Option<String>, EdgeAccount), ServerConfigError> {
    match text.split_once('/') {
        Some((site, edge)) => Ok((Some(site.to_owned()), edge.parse()?)),
        None => Ok((None, text.parse()?)),
    }
}

impl ServerConfigArgs {
    pub(super) fn run(&self) -> Result<()> {
        let sites = self.sites()?;
        let server = ServerSettings {
            name: format!("ihd-{}", self.sites[0]),
            listen: self.listen.clone(),
            mqtt_listen: self.mqtt.clone(),
            store: self.store.clone(),
            tls: self.tls.as_ref().map(|folder| TlsFiles {
                certificate: folder.join("certificate.pem"),
                key: folder.join("key.pem"),
            }),
        };
        // Checked before any key is made.
        sites.iter().try_for_each(server_config::check_site)?;
        let has_mqtt = self.mqtt.is_some();
        let names: Vec<String> = sites
            .iter()
            .flat_map(|site| site.key_names(has_mqtt))
            .collect();
        let keys = server_config::read_or_make(&self.keys, names.iter().map(String::as_str))?;
        let text = server_config::server_config(&server, &sites, &keys)?;
        ihd::cli::output::text(&text)
    }

    fn sites(&self) -> Result<Vec<Site>> {
        let new = |name: &String| {
            let site = Site::new(name, Vec::new(), self.workers);
            Site {
                disk_bytes: self.disk_bytes.unwrap_or(site.disk_bytes),
                ..site
            }
        };
        let mut sites: Vec<Site> = self.sites.iter().map(new).collect();
        for (site, edge) in &self.edges {
            let site = find(&mut sites, site.as_deref())?;
            site.edges.push(edge.clone());
        }
        for page in &self.fleet_pages {
            let (site, name) = match page.split_once('/') {
                Some((site, name)) => (Some(site), name),
                None => (None, page.as_str()),
            };
            let site = find(&mut sites, site)?;
            let edge = site.edges.iter_mut().find(|edge| edge.name == name);
            match edge {
                Some(edge) => edge.sees_fleet = true,
                None => ensure_usage!(false, "--fleet-page {page}: there is no such --edge"),
            }
        }
        Ok(sites)
    }
}

/// Returns the named site, or the only one.
fn find<'a>(sites: &'a mut [Site], name: Option<&str>) -> Result<&'a mut Site> {
    let named = match name {
        Some(name) => sites.iter_mut().find(|site| site.name == name),
        None => match sites {
            [only] => Some(only),
            _ => None,
        },
    };
    let why = || {
        let name = name.unwrap_or("none said");
        ihd::cli::usage::Usage(format!(
            "of which site? {name}: SITE/EDGE with one of the --site"
        ))
    };
    named.ok_or_else(|| why().into())
}
