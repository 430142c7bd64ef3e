use ihd_shared::wire::link_test::LinkTestCounts;
use ihd_shared::wire::messages::{AnyMessage, Log, Outcome};

use super::*;
use crate::DeviceEvent;
use crate::fake::{FakeDevice, FakeOutput};

/// A client of a device that greets, and that `answer` answers for.
fn client(mut answer: impl FnMut(&AnyMessage<'_>, &mut FakeOutput) + Send + 'static) -> Client {
    let on_message = move |message: &AnyMessage<'_>, sent: &mut FakeOutput| match message {
        AnyMessage::Hello(_) => sent.greet(),
        _ => answer(message, sent),
    };
    Client::connect(Box::new(FakeDevice::new(on_message, |_| {}))).unwrap()
}

/// Counts what comes and sends what is asked for, but for the frames of the numbers in `swallowed`.
fn link_tester(swallowed: &'static [u32]) -> impl FnMut(&AnyMessage<'_>, &mut FakeOutput) + Send {
    let mut received = LinkTestCounts::default();
    move |message, sent| match message {
        AnyMessage::LinkData(frame) if swallowed.contains(&frame.seq) => {}
        AnyMessage::LinkData(frame) => received.take(frame),
        AnyMessage::TestLink(test) => {
            sent.message(&received.counts());
            received = LinkTestCounts::NONE;
            let mut data = vec![0; usize::from(test.bytes)];
            for seq in (0..u32::from(test.frames)).filter(|seq| !swallowed.contains(seq)) {
                fill(seq, &mut data);
                let data = Raw(&data);
                sent.message(&LinkData { seq, data });
            }
        }
        _ => {}
    }
}

#[test]
fn a_restart_is_asked_for_once_and_a_refusal_says_why() {
    let mut asked = Vec::new();
    let mut device = client(move |message, sent| {
        if let AnyMessage::Restart(m) = message {
            asked.push(m.into);
            match asked.len() {
                1 => sent.done(),
                2 => sent.reply(Outcome::NotIdle),
                _ => panic!("asked again"),
            }
        }
    });
    device.restart(Program::Bootloader).unwrap();
    let refused = device.restart(Program::Firmware).unwrap_err();
    assert!(matches!(
        refused,
        LinkError::Refused {
            outcome: Outcome::NotIdle,
            ..
        }
    ));
    assert!(refused.to_string().contains("switch it off first"));
}

/// An older firmware of this major version answers every request, whether it knows it or not.
#[test]
fn a_request_that_a_device_does_not_know_names_the_way_out() {
    let mut device = client(|_, sent| sent.reply(Outcome::UnknownMessage));
    let errors = [
        device.restart(Program::Firmware).unwrap_err(),
        device.board().unwrap_err(),
        device.channels().unwrap_err(),
        device.test_link(1, 1).unwrap_err(),
        device.stream_log(true).unwrap_err(),
    ];
    for (error, name) in errors.iter().zip([
        "Restart",
        "GetBoard",
        "TestChannels",
        "TestLink",
        "StreamLog",
    ]) {
        let text = error.to_string();
        assert!(text.contains(name) && text.contains("ihd flash"), "{text}");
    }
}

#[test]
fn facts_and_tests_come_back_as_they_were_sent() {
    let mut device = client(|message, sent| match message {
        AnyMessage::GetBoard(_) => sent.message(&Board {
            id_code: 0x2003_6469,
            flash_kib: 512,
            option_bytes: 1,
            reset_flags: 2,
            starts: 3,
            image_bytes: 4,
            image_crc: 5,
            sealed_crc: 6,
            build_id: Raw(&[7; 20]),
            chip: Raw(&[8; 12]),
        }),
        AnyMessage::TestComparators(_) => sent.message(&Comparators {
            positive_tripped: true,
            positive_quiet: true,
            negative_tripped: true,
            negative_quiet: false,
        }),
        AnyMessage::TestClocks(_) => sent.reply(Outcome::Busy),
        _ => {}
    });
    let facts = device.board().unwrap();
    assert_eq!((facts.id_code, facts.sealed_crc), (0x2003_6469, 6));
    assert_eq!((facts.build_id.len(), facts.chip.len()), (20, 12));
    assert!(!device.comparators().unwrap().negative_quiet);
    assert!(matches!(
        device.clocks(),
        Err(LinkError::Refused {
            outcome: Outcome::Busy,
            ..
        })
    ));
}

#[test]
fn a_link_that_loses_nothing_loses_nothing() {
    let mut device = client(link_tester(&[]));
    for _ in 0..2 {
        let test = device.test_link(40, 960).unwrap();
        for counts in [&test.to_device, &test.from_device] {
            let LinkTested {
                frames,
                bytes,
                bad,
                lost,
            } = *counts;
            assert_eq!((frames, bytes, bad, lost), (40, 40 * 960, 0, 0));
        }
        assert!(test.from_device_took > Duration::ZERO);
    }
}

#[test]
fn what_is_lost_is_counted_the_last_as_well() {
    let mut device = client(link_tester(&[3, 4, 39]));
    let test = device.test_link(40, 100).unwrap();
    for counts in [&test.to_device, &test.from_device] {
        assert_eq!((counts.frames, counts.bad, counts.lost), (37, 0, 3));
    }
}

#[test]
fn the_log_comes_as_events() {
    let mut device = client(|message, sent| {
        if let AnyMessage::StreamLog(StreamLog { on: true }) = message {
            sent.done();
            sent.message(&Log {
                seq: 70,
                dropped: 2,
                data: Raw(&[1, 2, 0]),
            });
        }
    });
    device.stream_log(true).unwrap();
    let event = device.next_event(Duration::from_millis(10)).unwrap();
    let data = vec![1, 2, 0];
    assert_eq!(
        event,
        Some(DeviceEvent::Log {
            seq: 70,
            dropped: 2,
            data
        })
    );
}
