//! Users of the daemon: all commands in random order.

use std::sync::Arc;
use std::time::Duration;

use ihd_model::Command;
use ihd_shared::lookup::prior::prior;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use tokio::time::sleep;

use super::hob::HOBS;
use super::world::World;
use crate::daemon::Daemon;

/// Holders of the users; one holder may have two open pages.
const NAMES: [&str; 2] = ["ada", "bob"];

/// Issues random requests at random times, without waiting for the previous one.
pub async fn ask_at_random(world: Arc<World>, daemon: Daemon, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut hob, mut name) = (0, NAMES[0]);
    loop {
        // Either at once for the same holder and hob, as from two open pages, or later for others.
        let rest_ms = match rng.random_bool(0.5) {
            true => rng.random_range(0..20),
            false => {
                hob = world.any_hob(&mut rng);
                name = NAMES[rng.random_range(0..NAMES.len())];
                rng.random_range(100..4_000)
            }
        };
        sleep(Duration::from_millis(rest_ms)).await;
        let user = User {
            world: Arc::clone(&world),
            daemon: daemon.clone(),
            hob,
            name,
        };
        let power_w = 100 * rng.random_range(1..20u16);
        let force = rng.random_bool(0.3);
        let renewals = rng.random_range(0..5);
        let version = rng.random_bool(0.5).then(|| rng.random_range(0..4));
        match rng.random_range(0..12) {
            0..4 => tokio::spawn(user.heat(Command::Power { power_w }, renewals)),
            4 => {
                let powers_w = vec![power_w, 500, 1_000];
                tokio::spawn(user.heat(Command::Sweep { powers_w }, renewals))
            }
            5 | 6 => tokio::spawn(user.switch_off()),
            7 => tokio::spawn(user.command(Command::ClearFault)),
            8 => tokio::spawn(user.command(Command::LookupRollback { version })),
            9 => tokio::spawn(user.push_lookup()),
            10 => tokio::spawn(user.take_lease(force, renewals)),
            _ => tokio::spawn(user.release_lease()),
        };
    }
}

/// User of a hob.
pub struct User {
    pub world: Arc<World>,
    pub daemon: Daemon,
    pub hob: usize,
    pub name: &'static str,
}

impl User {
    fn hob_name(&self) -> &'static str {
        HOBS[self.hob]
    }

    /// Issues a command.
    pub async fn command(self, command: Command) {
        self.carry_out(command).await;
    }

    async fn carry_out(&self, command: Command) -> bool {
        let text = format!("{} {command:?} {}", self.name, self.hob_name());
        // Shortened, because a lookup has some hundred bytes.
        let text: String = text.chars().take(60).collect();
        self.world.note(&text);
        let outcome = self
            .daemon
            .command(self.hob_name(), self.name, command)
            .await;
        let reply = match &outcome {
            Ok(done) => done.text.clone(),
            Err(error) => error.to_string(),
        };
        self.world.note(&format!("  {text}: {reply}"));
        outcome.is_ok()
    }

    async fn heat(self, command: Command, renewals: u32) {
        self.world.number_heating_request(self.hob);
        if self.carry_out(command).await {
            self.renew(renewals).await;
        }
    }

    /// Switches off; returns `true` if that was acknowledged.
    pub async fn off(&self) -> bool {
        let number = self.world.number_off_request();
        let is_off = self.carry_out(Command::Off).await;
        if is_off {
            self.world.off_acknowledged(self.hob, number);
        }
        is_off
    }

    async fn switch_off(self) {
        self.off().await;
    }

    async fn push_lookup(self) {
        let mut lookup = prior();
        lookup.version = self.world.lock().sockets[self.hob].hob.lookup().version + 1;
        let blob = lookup.to_bytes().to_vec();
        self.carry_out(Command::LookupPush { blob }).await;
    }

    async fn take_lease(self, force: bool, renewals: u32) {
        let taken = self
            .daemon
            .take_lease(self.hob_name(), self.name, force)
            .await;
        let text = format!(
            "{} takes {} (force {force}): {taken:?}",
            self.name,
            self.hob_name()
        );
        self.world.note(&text);
        if taken.is_ok() {
            self.renew(renewals).await;
        }
    }

    /// Renews the lease as an open page does.
    async fn renew(&self, times: u32) {
        for _ in 0..times {
            sleep(Duration::from_secs(3)).await;
            // Another holder may have it by now.
            let _ = self
                .daemon
                .take_lease(self.hob_name(), self.name, false)
                .await;
        }
    }

    async fn release_lease(self) {
        let released = self.daemon.release_lease(self.hob_name(), self.name).await;
        let text = format!("{} releases {}: {released:?}", self.name, self.hob_name());
        self.world.note(&text);
    }
}
