//! Address and credentials of the fleet, for commands other than the daemon.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use ihd::cli::global::Global;
use ihd::ensure_usage;
use ihd_fleet::{Access, Context};
use tokio::runtime::Runtime;

/// Address and credentials of the fleet.
#[derive(Debug, Args)]
#[command(next_help_heading = "Fleet")]
pub struct AccessArgs {
    /// Address of the server, nats://HOST:PORT or tls://HOST:PORT; several of a cluster with commas between. Without it $IHD_FLEET_URL, or
    /// [fleet] of ihd.toml
    #[arg(long, global = true, value_name = "URL")]
    url: Option<String>,
    /// File with an NKey's seed (docs/fleet.md)
    #[arg(
        long,
        global = true,
        value_name = "FILE",
        conflicts_with = "token_file"
    )]
    nkey_file: Option<PathBuf>,
    /// File with a token
    #[arg(long, global = true, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// PEM file of the authority that the server's certificate is of; that of the system without
    #[arg(long, global = true, value_name = "FILE")]
    ca: Option<PathBuf>,
}

impl AccessArgs {
    /// Returns address and credentials.
    ///
    /// # Errors
    /// If the fleet's address is not given.
    pub fn access(&self, global: &Global) -> Result<Access> {
        let given = self.url.clone();
        let given = given.or_else(|| std::env::var("IHD_FLEET_URL").ok());
        let of_file = match given {
            Some(_) => None,
            None => ihd::cli::configured::config(global.config.as_deref())?.fleet,
        };
        let mut access = of_file.as_ref().map(Access::from).unwrap_or_default();
        if let Some(url) = given {
            access.url = url;
        }
        ensure_usage!(
            !access.url.is_empty(),
            "which fleet? --url nats://HOST:PORT, $IHD_FLEET_URL, or [fleet] url in ihd.toml"
        );
        if self.nkey_file.is_some() || self.token_file.is_some() {
            (access.nkey_file, access.token_file) =
                (self.nkey_file.clone(), self.token_file.clone());
        }
        access.ca = self.ca.clone().or(access.ca);
        Ok(access)
    }

    /// Connects to the fleet and runs `what`.
    ///
    /// # Errors
    /// [`ihd_fleet::AccessError`], or the error of `what`.
    pub fn with<T>(
        &self,
        global: &Global,
        what: impl AsyncFnOnce(&Access, Context) -> Result<T>,
    ) -> Result<T> {
        let access = self.access(global)?;
        Runtime::new()?.block_on(async {
            let name = format!("ihd-{}", std::process::id());
            let context = access.connect(&name).await?;
            what(&access, context).await
        })
    }
}
