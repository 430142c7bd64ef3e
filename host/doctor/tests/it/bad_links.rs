//! Links that are cut anywhere, damage what they carry, or end at an older device.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use ihd_doctor::{CheckResult, board, first_switching};
use ihd_link::{Client, LinkError, Transport};
use ihd_sim::hob::SimHob;
use ihd_sim::transport::SharedHob;

use crate::desk::{Watched, complete, failed, find_check, on_bench};

fn hob() -> SharedHob {
    SharedHob::new(SimHob::new(&on_bench(40.0)))
}

#[test]
fn a_cable_pulled_anywhere_leaves_a_whole_report() {
    for frames in [0, 1, 2, 4, 50, 150, 206] {
        let watched = Watched::new(hob());
        let left = watched.frames_left.clone();
        let mut client = Client::connect(Box::new(watched)).unwrap();
        left.store(frames, Ordering::Relaxed);
        let found = board::examine(&mut client);
        complete(&found.checks, &board::NAMES);
        let lost = found
            .lost
            .unwrap_or_else(|| panic!("{frames}: {:#?}", found.checks));
        assert!(lost.contains("lost"), "{lost}");
        assert_eq!(
            failed(&found.checks),
            [] as [&str; 0],
            "{frames}: a cable is no fault of the board"
        );
        assert_eq!(
            find_check(&found.checks, "link_from_device").verdict,
            CheckResult::NotTested
        );
    }
}

/// However early or late it is pulled while it switches, the report says that nobody switched it off.
#[test]
fn a_cable_pulled_while_it_switches_is_told_and_the_device_ends_by_itself() {
    for frames in [3, 5] {
        let hob = hob();
        let watched = Watched::new(hob.clone());
        let left = watched.frames_left.clone();
        let mut client = Client::connect(Box::new(watched)).unwrap();
        left.store(frames, Ordering::Relaxed);
        let (checks, lost) = first_switching::run(&mut client, None, &AtomicBool::new(false));
        complete(&checks, &first_switching::NAMES);
        assert!(lost.is_some(), "{frames}");
        let off = find_check(&checks, "power_off");
        assert_eq!(off.verdict, CheckResult::Fail, "{frames}: {off:?}");
        assert!(off.remedy.as_ref().unwrap().contains("supply off"));
        // 10 s without a host, on its own.
        let until_s = hob.lock().t_s() + 11.0;
        while hob.lock().t_s() < until_s {
            hob.lock().step();
        }
        let status = Client::connect(Box::new(hob)).unwrap().status().unwrap();
        assert_eq!(status.asked_w, 0, "{frames}");
    }
}

#[test]
fn a_link_that_damages_frames_fails_by_its_own_numbers() {
    let mut watched = Watched::new(hob());
    watched.turn_every = 9;
    let mut client = Client::connect(Box::new(watched)).unwrap();
    let found = board::examine(&mut client);
    complete(&found.checks, &board::NAMES);
    assert_ne!(
        find_check(&found.checks, "link_from_device").verdict,
        CheckResult::Pass,
        "{:#?}",
        found.checks
    );
}

/// Takes everything, and says nothing any more.
struct Deaf {
    hob: SharedHob,
    answers: u32,
}

impl Transport for Deaf {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        self.hob.send(bytes)
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let n = self.hob.receive(buf, timeout)?;
        if n > 0 && self.answers == 0 {
            return Ok(0);
        }
        self.answers -= u32::from(n > 0);
        Ok(n)
    }

    fn describe(&self) -> String {
        "deaf".to_owned()
    }

    fn clock(&self) -> Duration {
        self.hob.clock()
    }
}

#[test]
fn a_device_that_falls_silent_is_given_up_after_two_questions() {
    let hob = hob();
    let deaf = Deaf {
        hob: hob.clone(),
        answers: 3,
    };
    let mut client = Client::connect(Box::new(deaf)).unwrap();
    let begin = client.clock();
    let found = board::examine(&mut client);
    complete(&found.checks, &board::NAMES);
    assert!(
        found
            .lost
            .is_some_and(|lost| lost.contains("answers no more"))
    );
    let waited = client.clock().saturating_sub(begin);
    assert!(waited < Duration::from_secs(10), "{waited:?}");
}
