//! The real firmware over a link whose frames are late, lost, doubled and out of order both ways, in the desk's own time: a
//! request is carried out once or not at all, and its answer is nobody else's.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use ihd_link::{Client, LinkError, Transport};
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use ihd_shared::wire::messages::Outcome;
use ihd_tests::desk_hob::{DeskHob, DeskLink, desk_hello};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Longest delay of a frame, in milliseconds; a request has 300 for all its tries.
const LATEST_MS: u64 = 700;

/// Frames under way, with the time at which they arrive.
#[derive(Default)]
struct Way(Vec<(u64, Vec<u8>)>);

impl Way {
    /// Sends a frame on its way: lost, twice, at once or late.
    fn send(&mut self, now_ns: u64, frame: &[u8], chance: &mut Option<ChaCha8Rng>) {
        let Some(chance) = chance else {
            return self.0.push((now_ns, frame.to_vec()));
        };
        let copies = [1, 1, 1, 1, 2, 0][chance.random_range(0..6)];
        for _ in 0..copies {
            let late = chance.random_range(0..3) == 0;
            let ms = if late {
                chance.random_range(1..LATEST_MS)
            } else {
                0
            };
            self.0.push((now_ns + 1_000_000 * ms, frame.to_vec()));
        }
    }

    /// The next frame that is due.
    fn arrived(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        let due = self.0.iter().enumerate().min_by_key(|(_, (at, _))| *at);
        let at = due.filter(|(_, (at, _))| *at <= now_ns)?.0;
        Some(self.0.remove(at).1)
    }
}

/// The host's end of such a link.
struct Late {
    desk: DeskLink,
    chance: Arc<Mutex<Option<ChaCha8Rng>>>,
    /// Frames that the device has sent and that are not on their way yet.
    sent: Arc<Mutex<Vec<Vec<u8>>>>,
    to_device: Way,
    to_host: Way,
}

impl Late {
    fn new(chance: Arc<Mutex<Option<ChaCha8Rng>>>) -> Self {
        let desk = DeskLink::new(DeskHob::new(desk_hello()));
        let sent = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&sent);
        desk.hob().mangle = Box::new(move |frame| {
            heard.lock().unwrap().push(frame.to_vec());
            Vec::new()
        });
        Self {
            desk,
            chance,
            sent,
            to_device: Way::default(),
            to_host: Way::default(),
        }
    }
}

impl Transport for Late {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let now_ns = self.desk.hob().time_ns();
        let mut chance = self.chance.lock().unwrap();
        self.to_device.send(now_ns, bytes, &mut chance);
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let mut hob = self.desk.hob();
        let deadline_ns = hob.time_ns() + timeout.as_nanos() as u64;
        loop {
            let now_ns = hob.time_ns();
            while let Some(frame) = self.to_device.arrived(now_ns) {
                hob.offer(&frame);
            }
            let mut chance = self.chance.lock().unwrap();
            for frame in self.sent.lock().unwrap().drain(..) {
                self.to_host.send(now_ns, &frame, &mut chance);
            }
            drop(chance);
            if let Some(frame) = self.to_host.arrived(now_ns) {
                buf[..frame.len()].copy_from_slice(&frame);
                return Ok(frame.len());
            }
            if now_ns >= deadline_ns {
                return Ok(0);
            }
            hob.step();
        }
    }

    fn describe(&self) -> String {
        "late".to_owned()
    }

    fn clock(&self) -> Duration {
        self.desk.clock()
    }
}

/// States that the device may be in, as far as the host has heard.
struct Known {
    powers_w: Vec<u16>,
    version: u32,
    pushes: u32,
    acknowledged: u32,
    /// The last push was not answered: it may be waiting for its half-cycle.
    unsure: bool,
    unanswered: u32,
}

impl Known {
    /// Takes what came of a request; true where it was done.
    fn is_done<T>(&mut self, outcome: Result<T, LinkError>) -> bool {
        match outcome {
            Ok(_) => true,
            Err(LinkError::NoAnswer { .. }) => {
                self.unanswered += 1;
                false
            }
            Err(other) => panic!("{other}"),
        }
    }

    fn set_power(&mut self, client: &mut Client, power_w: u16) {
        let outcome = client.set_power(power_w);
        if self.is_done(outcome) {
            self.powers_w.clear();
        }
        self.powers_w.push(power_w);
    }

    fn push(&mut self, client: &mut Client) {
        self.version += 1;
        self.pushes += 1;
        let lookup = RlLookup {
            version: self.version,
            ..prior()
        };
        match client.push_lookup(&lookup) {
            Err(LinkError::Refused {
                outcome: Outcome::Busy,
                ..
            }) if self.unsure => self.unsure = false,
            outcome => {
                let done = self.is_done(outcome);
                self.acknowledged += u32::from(done);
                self.unsure = !done;
            }
        }
    }

    /// The power in force is one of those that may be, and no late request makes it another.
    fn look(&mut self, client: &mut Client) {
        match client.status() {
            Ok(status) => {
                assert!(
                    self.powers_w.contains(&status.asked_w),
                    "{:?}: {status:?}",
                    self.powers_w
                );
                self.powers_w = vec![status.asked_w];
            }
            Err(why) => drop(self.is_done::<()>(Err(why))),
        }
    }
}

#[test]
fn a_request_is_carried_out_once_or_not_at_all() {
    let (mut unanswered, mut strays) = (0, 0);
    for seed in 0..20 {
        let chance = Arc::new(Mutex::new(None));
        let late = Late::new(Arc::clone(&chance));
        let desk = late.desk.clone();
        let mut client = Client::connect(Box::new(late)).unwrap();
        client.set_timeout(Duration::from_millis(300));
        *chance.lock().unwrap() = Some(ChaCha8Rng::seed_from_u64(seed));
        let mut what = ChaCha8Rng::seed_from_u64(1_000 + seed);
        let mut known = Known {
            powers_w: vec![0],
            version: 0,
            pushes: 0,
            acknowledged: 0,
            unsure: false,
            unanswered: 0,
        };
        for _ in 0..40 {
            match what.random_range(0..4) {
                0 => known.set_power(&mut client, what.random_range(0..25) * 100),
                1 => {
                    // A half-cycle after the last, which is active by then if it was taken.
                    client.next_event(Duration::from_millis(11)).unwrap();
                    known.push(&mut client);
                }
                _ => known.look(&mut client),
            }
        }
        // What is still on its way arrives; nothing comes of it.
        client
            .next_event(Duration::from_millis(2 * LATEST_MS))
            .unwrap();
        *chance.lock().unwrap() = None;
        known.look(&mut client);
        let changes = desk.hob().housekeeping().lookup_changes();
        assert!(
            (known.acknowledged..=known.pushes).contains(&changes),
            "seed {seed}: {changes} of {} taken, {} said so",
            known.pushes,
            known.acknowledged
        );
        unanswered += known.unanswered;
        strays += client.counters().answers_stray;
    }
    assert!(
        unanswered > 50 && strays > 50,
        "{unanswered}, {strays}: the link was not bad enough"
    );
}
