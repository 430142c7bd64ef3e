//! What is asked of a device, carried out.

use ihd_link::{Client, LinkError};
use ihd_shared::hob::RATED_POWER_W;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use tokio::time::Instant;

use super::lookups::before_this;
use super::recording;
use super::session::{Ended, HeatError, Session};
use super::sweep::Sweep;
use super::{Answer, Order};
use crate::learning::Lookup;
use crate::lease::{LeaseId, LeaseOver};
use crate::looks::newest;
use crate::model::{Command, CommandError, Done};
use crate::printable::printable;

/// Powers of one sweep, at most.
const LONGEST_SWEEP: usize = 64;

impl Session<'_> {
    /// Carries out an order; an error is the session's end.
    pub(super) async fn on_order(&mut self, order: Order) -> Result<(), Ended> {
        match order {
            Order::News(lookup) => {
                self.on_news(lookup).await;
                Ok(())
            }
            Order::Command {
                command,
                lease,
                answer,
            } => self.on_command(command, lease, answer).await,
        }
    }

    async fn on_command(
        &mut self,
        command: Command,
        lease: Option<LeaseId>,
        answer: Answer,
    ) -> Result<(), Ended> {
        let mut ended = Ok(());
        // It may have waited longer than its lease lived.
        let is_off = matches!(command, Command::Power { power_w: 0 });
        if let Some(id) = lease.filter(|_| !is_off) {
            let living = self.face.lock().lease.check(id, Instant::now());
            if let Err(over) = living {
                let _ = answer.send(Err(self.refused(&over.to_string())));
                return Ok(());
            }
        }
        let outcome = match command {
            Command::Off | Command::Power { power_w: 0 } => {
                let off = self.off().await;
                let done = off.as_ref().map(|()| "off".to_owned()).map_err(words);
                ended = off.map_err(|error| Ended::Link(error.to_string()));
                done
            }
            Command::Power { power_w } => self.power(lease, power_w).await,
            Command::Sweep { powers_w } => self.start_sweep(lease, &powers_w),
            Command::ClearFault => {
                let cleared = self.ask(Client::clear_fault).await;
                cleared
                    .map(|()| "fault cleared".to_owned())
                    .map_err(|e| words(&e))
            }
            Command::LookupPush { blob } => match RlLookup::from_bytes(&blob) {
                Ok(lookup) => {
                    // Answered when the device uses it.
                    let lookup = Lookup::without_confidence(lookup);
                    let _ = self.push(lookup, "pushed by hand", Some(answer)).await;
                    return Ok(());
                }
                Err(why) => Err(why.to_string()),
            },
            Command::LookupRollback { version } => match self.earlier(version).await {
                Ok(lookup) => {
                    let why = format!("rolled back to version {}", lookup.lookup.version);
                    let _ = self.push(lookup, &why, Some(answer)).await;
                    return Ok(());
                }
                Err(why) => Err(why),
            },
            Command::LookupReset => {
                let reset = self.reset_lookup().await;
                let done = "back to the built-in lookup; what was learned is forgotten";
                reset.map(|()| done.to_owned()).map_err(|e| words(&e))
            }
            Command::RecordStart(settings) => {
                self.start_recording(settings, answer).await;
                return Ok(());
            }
            Command::RecordStop => {
                recording::stop(self.face, answer);
                return Ok(());
            }
        };
        let _ = answer.send(match outcome {
            Ok(text) => Ok(Done { text, file: None }),
            Err(why) => Err(self.refused(&why)),
        });
        ended
    }

    /// A lookup of the store's: of this version, or the one that was active before.
    async fn earlier(&self, version: Option<u32>) -> Result<Lookup, String> {
        let on_device = self.face.lock().lookup.on_device.unwrap_or(0);
        let rows = self.rows().await.ok_or("the store does not answer")?;
        let lookup = match version {
            // Whose cells are those of the device's own.
            Some(0) => Some(prior()),
            Some(version) => {
                newest(&rows, version).and_then(|r| RlLookup::from_bytes(&r.blob).ok())
            }
            None => before_this(on_device, &rows),
        };
        let lookup = lookup.ok_or_else(|| match version {
            Some(version) => format!("the store holds no lookup of version {version}"),
            None => "the store holds no lookup that was active before".to_owned(),
        })?;
        let (name, of) = (self.face.name.clone(), lookup.version);
        let confidence = self
            .context
            .in_store(move |store| store.confidence(&name, of));
        Ok(Lookup {
            confidence: confidence.await.flatten(),
            lookup,
        })
    }

    fn refused(&self, why: &str) -> CommandError {
        CommandError::Refused {
            name: self.face.name.clone(),
            why: printable(why),
        }
    }

    async fn power(&mut self, lease: Option<LeaseId>, power_w: u16) -> Result<String, String> {
        let lease = lease.ok_or_else(|| LeaseOver::Ended.to_string())?;
        self.sweep = None;
        self.face.lock().sweep_left_w.clear();
        match self.heat(lease, power_w).await {
            Ok(()) => Ok(format!("{power_w} W asked for")),
            Err(error) => {
                let is_unknown = match &error {
                    HeatError::Lease(_) | HeatError::Link(LinkError::Refused { .. }) => false,
                    HeatError::Link(_) => true,
                };
                if is_unknown {
                    // It may heat, and must not.
                    let _ = self.off().await;
                }
                Err(error.to_string())
            }
        }
    }

    fn start_sweep(&mut self, lease: Option<LeaseId>, powers_w: &[u16]) -> Result<String, String> {
        let lease = lease.ok_or_else(|| LeaseOver::Ended.to_string())?;
        if powers_w.is_empty() || powers_w.len() > LONGEST_SWEEP {
            return Err(format!("a sweep has 1 to {LONGEST_SWEEP} powers"));
        }
        if let Some(wrong) = powers_w.iter().find(|&&w| w == 0 || w > RATED_POWER_W) {
            return Err(format!("{wrong} W is not 1 to {RATED_POWER_W} W"));
        }
        let sweep = Sweep::new(powers_w);
        {
            let mut inner = self.face.lock();
            let kept = inner.lease.keep(lease, Instant::now());
            kept.map_err(|over| over.to_string())?;
            inner.sweep_left_w = sweep.left_w();
        }
        self.sweep = Some((lease, sweep));
        Ok(format!(
            "sweep through {} powers begun; it ends with the lease",
            powers_w.len()
        ))
    }
}

fn words(error: &LinkError) -> String {
    error.to_string()
}
