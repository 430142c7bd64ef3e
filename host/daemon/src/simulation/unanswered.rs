//! Requests whose answers are lost.

use std::time::Duration;

use ihd_model::Command;
use tokio::time::sleep;

use super::calm::{POWER_W, asked_w, heat, with_daemon};
use super::hob::HOBS;

/// The hob has the power of the request already, so that no check of its power finds a difference.
#[test]
fn power_without_an_answer_ends_even_if_its_off_has_none() {
    with_daemon(async |world, daemon| {
        let name = HOBS[0];
        heat(daemon).await;
        world.lock().sockets[0].is_mute = true;
        let asking = daemon.clone();
        let same = Command::Power { power_w: POWER_W };
        let again = tokio::spawn(async move { asking.command(name, "ada", same).await });
        // The request takes 2 s, then two requests to switch off.
        sleep(Duration::from_secs(5)).await;
        assert_eq!((asked_w(world), again.is_finished()), (POWER_W, false));
        world.lock().sockets[0].is_mute = false;
        again.await.unwrap().expect_err("nothing was answered");
        sleep(Duration::from_secs(1)).await;
        assert!(daemon.view().device(name).unwrap().lease.is_some());
        assert_eq!(asked_w(world), 0);
    });
}

#[test]
fn who_gives_the_lease_back_is_told_that_the_off_has_no_answer() {
    with_daemon(async |world, daemon| {
        let name = HOBS[0];
        heat(daemon).await;
        world.lock().sockets[0].is_mute = true;
        let released = daemon.release_lease(name, "ada").await;
        let why = released.unwrap_err().to_string();
        assert!(why.contains("not confirmed"), "{why}");
        assert!(daemon.view().device(name).unwrap().lease.is_none());
    });
}
