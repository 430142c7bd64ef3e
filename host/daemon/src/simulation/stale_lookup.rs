//! A learned lookup that was on its way to the device when a person reset what was learned.

use std::time::Duration;

use ihd_model::Command;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::prior::prior;
use tokio::time::sleep;

use super::calm::with_daemon;
use super::hob::HOBS;
use crate::device::DeviceRequest;
use crate::learning::LookupToPush;

#[test]
fn a_lookup_from_before_a_reset_is_not_pushed_after_it() {
    with_daemon(async |_, daemon| {
        let name = HOBS[0];
        let push = async |version, forgotten_count| {
            let lookup = RlLookup { version, ..prior() };
            let push = DeviceRequest::PushLookup {
                lookup: Box::new(LookupToPush::without_certainty(lookup)),
                forgotten_count,
            };
            let requests = daemon.handle_of(name).unwrap().requests;
            assert!(requests.send(push).await.is_ok());
            sleep(Duration::from_secs(2)).await;
            daemon.view().device(name).unwrap().lookup.on_device
        };
        assert_eq!(push(1, 0).await, Some(1));
        let reset = daemon.command(name, "ada", Command::LookupReset);
        reset.await.expect("it is reset");
        assert_eq!(push(2, 0).await, Some(0));
        assert_eq!(push(1, 1).await, Some(1));
    });
}
