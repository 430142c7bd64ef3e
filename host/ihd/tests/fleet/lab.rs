//! Two sites on one server, configured as `ihd-fleet init server-config` would: TLS, a key for everybody.

use std::collections::BTreeMap;
use std::fs;
use std::path::PathBuf;
use std::time::Duration;

use async_nats::jetstream;
use async_nats::{Client, ConnectOptions};
use ihd_fleet::jetstream::{FleetLimits, init, init_edge};
use ihd_fleet::server_config::{EdgeAccount, Site, TlsFiles, UserKey, server_config};

use crate::server::{Server, ServerLocation};

/// The server, the keys of all clients, and the server's certificate.
pub struct Lab {
    pub server: Server,
    keys: BTreeMap<String, UserKey>,
    certificate: PathBuf,
    sites: Vec<Site>,
}

impl Lab {
    /// Starts sites `lab` (edges lab-1 with hob-a and hob-b, which may read the fleet, and lab-2 with hob-c; two workers) and `field`
    /// (edge field-1 with a hob-a of its own).
    pub async fn start() -> Self {
        let mut first: EdgeAccount = "lab-1=hob-a,hob-b".parse().unwrap();
        first.sees_fleet = true;
        let lab = Site::new("lab", vec![first, "lab-2=hob-c".parse().unwrap()], 2);
        let field = Site::new("field", vec!["field-1=hob-a".parse().unwrap()], 1);
        let lab = Self::with_sites(vec![lab, field]);
        // 12 GB for each site, in GiB, independent of the disk's free space.
        let log = lab.server.log();
        assert!(log.contains("Max Storage:     22.35 GB"), "{log}");
        for site in &lab.sites {
            lab.make_streams(site).await;
        }
        lab
    }

    /// Starts an empty server for sites.
    pub fn with_sites(sites: Vec<Site>) -> Self {
        let names = sites.iter().flat_map(|site| site.key_names(true));
        let keys: BTreeMap<_, _> = names.map(|name| (name, UserKey::make().unwrap())).collect();
        let server = Server::configured(|place| server_config(&at(place), &sites, &keys).unwrap());
        Self {
            certificate: server.folder().join("certificate.pem"),
            server,
            keys,
            sites,
        }
    }

    /// Writes the configuration anew without an edge, as `ihd-fleet init server-config` after its loss.
    pub fn forget_edge(&mut self, name: &str) {
        for site in &mut self.sites {
            site.edges.retain(|edge| edge.name != name);
        }
        let place = ServerLocation {
            address: match self.server.address().ip() {
                std::net::IpAddr::V4(address) => address,
                std::net::IpAddr::V6(other) => panic!("{other}"),
            },
            folder: self.server.folder().to_owned(),
        };
        let text = server_config(&settings(&place), &self.sites, &self.keys).unwrap();
        self.server.rewrite(|_| text);
    }

    /// Returns the address for clients, `tls://…`.
    pub fn url(&self) -> String {
        format!("tls://{}", self.server.address())
    }

    /// Returns the file of the server's certificate.
    pub fn certificate(&self) -> PathBuf {
        self.certificate.clone()
    }

    /// Returns the key of a name of [`Site::key_names`].
    pub fn key(&self, name: &str) -> &UserKey {
        &self.keys[name]
    }

    /// Returns the options of a key's owner, without reconnection.
    pub fn options(&self, key: &str) -> ConnectOptions {
        ConnectOptions::with_nkey(self.key(key).seed().to_owned())
            .add_root_certificates(self.certificate())
            .require_tls(true)
            .request_timeout(Some(Duration::from_secs(5)))
            .connection_timeout(Duration::from_secs(5))
    }

    /// Connects a client with a key.
    pub async fn client(&self, key: &str) -> Client {
        let connected = self.options(key).connect(self.url()).await;
        connected.unwrap_or_else(|why| panic!("{key}: {why}\n{}", self.server.log()))
    }

    /// Connects to JetStream with a key.
    pub async fn jetstream(&self, key: &str) -> jetstream::Context {
        jetstream::new(self.client(key).await)
    }

    /// Files of the operator (`ihd-fleet init`).
    async fn make_streams(&self, site: &Site) {
        let js = self.jetstream(&format!("{}-operator", site.name)).await;
        init(&js, &FleetLimits::default()).await.unwrap();
        for edge in &site.edges {
            let made = init_edge(&js, &edge.name, &edge.hobs).await;
            made.unwrap();
        }
    }
}

/// Returns the server's settings for a place; writes its certificate there.
fn at(place: &ServerLocation) -> ihd_fleet::server_config::ServerSettings {
    let names = vec!["localhost".to_owned(), place.address.to_string()];
    let made = rcgen::generate_simple_self_signed(names).unwrap();
    fs::write(place.folder.join("certificate.pem"), made.cert.pem()).unwrap();
    fs::write(
        place.folder.join("key.pem"),
        made.signing_key.serialize_pem(),
    )
    .unwrap();
    settings(place)
}

fn settings(place: &ServerLocation) -> ihd_fleet::server_config::ServerSettings {
    let any = format!("{}:-1", place.address);
    ihd_fleet::server_config::ServerSettings {
        name: "ihd-test".to_owned(),
        listen: any.clone(),
        mqtt_listen: Some(any),
        store: place.folder.join("store"),
        tls: Some(TlsFiles {
            certificate: place.folder.join("certificate.pem"),
            key: place.folder.join("key.pem"),
        }),
    }
}
