//! Register sequences of RM0440, chapter 45, and USB 2.0, chapters 5 and 8.

use super::*;

/// Offsets of the buffers of endpoint 0 and of endpoint 1.
const CONTROL_OUT: u32 = 0x40;
const CONTROL_IN: u32 = 0x80;
const BULK_OUT: u32 = 0xC0;
const BULK_IN: u32 = 0x100;
/// COUNTn_RX of 64 bytes: BL_SIZE, and two blocks, written as 1.
const BLOCKS_64: u32 = 0x8400;

/// Peripheral that is powered, out of reset and pulled up.
fn started() -> Usb {
    let mut usb = Usb::new();
    usb.set_time(0.0);
    usb.write(CNTR, 0x0001);
    usb.set_time(1.5);
    usb.write(BTABLE, 0);
    usb.write(CNTR, 0x9C00);
    usb.write(BCDR, PULL_UP);
    usb
}

/// Peripheral with address 5 after a reset of the bus: endpoint 0 of type control, endpoint 1 bulk.
fn configured() -> Usb {
    let mut usb = started();
    usb.bus_reset();
    usb.write(ISTR, !0x0400 & 0xFFFF);
    usb.write(DADDR, 0x85);
    let descriptors = [
        CONTROL_IN,
        0,
        CONTROL_OUT,
        BLOCKS_64,
        BULK_IN,
        0,
        BULK_OUT,
        BLOCKS_64,
    ];
    for (place, value) in descriptors.into_iter().enumerate() {
        usb.pma_write(2 * place as u32, 2, value);
    }
    // NAK both ways; then bulk: VALID to receive, NAK to send.
    usb.write(0, 0x2220);
    usb.write(4, 0x3021);
    assert_eq!(usb.violations, [""; 0]);
    usb
}

#[test]
fn after_a_reset_of_the_chip_it_is_off() {
    let mut usb = Usb::new();
    assert_eq!(usb.read(CNTR), 3);
    assert!(!usb.attached() && !usb.interrupt());
    assert_eq!(usb.setup(0, 0, [0; 8]), Handshake::Nothing);
}

#[test]
fn leaving_the_forced_reset_announces_a_reset() {
    let mut usb = started();
    assert_eq!(usb.read(ISTR), 0x0400);
    assert!(usb.interrupt() && usb.attached());
    usb.write(ISTR, 0xFBFF);
    assert!(!usb.interrupt());
    assert_eq!(usb.violations, [""; 0]);
}

#[test]
fn the_start_up_time_is_kept() {
    let mut usb = Usb::new();
    usb.set_time(10.0);
    usb.write(CNTR, 1);
    usb.set_time(10.5);
    usb.write(CNTR, 0);
    assert_eq!(usb.violations.len(), 1);
    let mut usb = Usb::new();
    usb.write(CNTR, 2);
    assert_eq!(usb.violations, ["USB: the reset is lifted in power-down"]);
}

#[test]
fn a_reset_of_the_bus_disables_all_until_it_is_acknowledged() {
    let mut usb = configured();
    usb.bus_reset();
    assert!(usb.interrupt());
    assert_eq!((usb.read(0), usb.read(4), usb.read(DADDR)), (0, 0, 0));
    usb.write(DADDR, 0x80);
    usb.write(0, 0x2220);
    assert_eq!(usb.setup(0, 0, [0; 8]), Handshake::Nothing);
    usb.write(ISTR, 0xFBFF);
    assert_eq!(usb.setup(0, 0, [0; 8]), Handshake::Ack);
}

#[test]
fn only_its_own_address_is_answered() {
    let mut usb = configured();
    assert_eq!(usb.setup(4, 0, [0; 8]), Handshake::Nothing);
    assert_eq!(usb.input(4, 0), Answer::Nothing);
    assert_eq!(usb.input(5, 0), Answer::Nak);
    assert_eq!(usb.input(5, 2), Answer::Nothing);
}

#[test]
fn a_setup_is_taken_in_spite_of_nak_and_sets_both_toggles() {
    let mut usb = configured();
    let packet = [0x80, 6, 0, 1, 0, 0, 64, 0];
    assert_eq!(usb.setup(5, 0, packet), Handshake::Ack);
    // CTR_RX, DTOG_RX, NAK, SETUP, control, DTOG_TX, NAK.
    assert_eq!(
        usb.read(0),
        0x8000 | 0x4000 | 0x2000 | 0x0800 | 0x0200 | 0x0040 | 0x0020
    );
    assert_eq!(usb.read(ISTR), 0x8010);
    assert_eq!(usb.pma_read(6, 2), BLOCKS_64 | 8);
    assert_eq!(usb.pma_read(CONTROL_OUT, 2), 0x0680);
    // The next is lost until this one is acknowledged.
    assert_eq!(usb.setup(5, 0, packet), Handshake::Nothing);
    usb.write(0, 0x0280);
    assert_eq!(usb.setup(5, 0, packet), Handshake::Ack);
}

#[test]
fn a_control_read_goes_by_data1_and_ends_with_an_empty_packet() {
    let mut usb = configured();
    usb.setup(5, 0, [0x80, 6, 0, 1, 0, 0, 64, 0]);
    usb.read(0);
    usb.write(0, 0x0280);
    usb.pma_write(CONTROL_IN, 2, 0x0112);
    usb.pma_write(2, 2, 2);
    // STAT_TX NAK → VALID, STAT_RX NAK → VALID, STATUS_OUT.
    usb.write(0, 0x9390);
    assert_eq!(usb.input(5, 0), Answer::Data(Toggle::Data1, vec![0x12, 1]));
    assert_eq!(usb.read(0) & 0x00F0, 0x00A0, "CTR_TX, DATA0 next, NAK");
    assert_eq!(usb.input(5, 0), Answer::Nak);
    assert_eq!(usb.out(5, 0, Toggle::Data1, &[]), Handshake::Ack);
    assert_eq!(usb.read(0) & 0x0800, 0, "not a SETUP");
}

#[test]
fn status_out_takes_nothing_but_an_empty_packet() {
    let mut usb = configured();
    usb.setup(5, 0, [0; 8]);
    usb.read(0);
    usb.write(0, 0x1380);
    assert_eq!(usb.out(5, 0, Toggle::Data1, &[1]), Handshake::Stall);
    assert_eq!(usb.read(0) & 0x3000, 0x1000);
}

#[test]
fn bulk_packets_alternate_and_a_repeated_one_is_dropped() {
    let mut usb = configured();
    assert_eq!(usb.out(5, 1, Toggle::Data0, b"one"), Handshake::Ack);
    assert_eq!(
        usb.pma_read(BULK_OUT, 2),
        u32::from(b'o') | u32::from(b'n') << 8
    );
    assert_eq!(usb.read(ISTR), 0x8011);
    assert_eq!(usb.out(5, 1, Toggle::Data1, b"two"), Handshake::Nak);
    // CTR_RX cleared, NAK → VALID.
    usb.read(4);
    usb.write(4, 0x1081);
    assert_eq!(usb.out(5, 1, Toggle::Data0, b"one"), Handshake::Ack);
    assert_eq!(usb.read(4) & 0x8000, 0, "the program does not see it again");
    assert_eq!(usb.out(5, 1, Toggle::Data1, b"two"), Handshake::Ack);
    assert_eq!(usb.read(4) & 0x8000, 0x8000);
}

#[test]
fn bulk_sends_what_the_descriptor_says() {
    let mut usb = configured();
    usb.pma_write(BULK_IN, 2, 0x4241);
    usb.pma_write(BULK_IN + 2, 2, 0x43);
    usb.pma_write(10, 2, 3);
    usb.write(4, 0x8091);
    assert_eq!(
        usb.input(5, 1),
        Answer::Data(Toggle::Data0, b"ABC".to_vec())
    );
    assert_eq!(usb.read(ISTR), 0x8001);
    assert_eq!(usb.input(5, 1), Answer::Nak);
    // CTR_TX cleared, NAK → VALID.
    usb.read(4);
    usb.write(4, 0x8011);
    assert!(!usb.interrupt());
    assert!(matches!(usb.input(5, 1), Answer::Data(Toggle::Data1, _)));
    assert_eq!(usb.violations, [""; 0]);
}

#[test]
fn a_packet_too_long_for_its_buffer_is_stalled_and_reported() {
    let mut usb = configured();
    assert_eq!(usb.out(5, 1, Toggle::Data0, &[0; 65]), Handshake::Stall);
    assert_eq!(
        usb.violations,
        ["USB: EP1R has no room for a packet of 65 bytes"]
    );
    assert_eq!(usb.read(ISTR) & 0x8000, 0);
}

#[test]
fn buffers_that_cannot_be_are_reported_when_they_become_valid() {
    let mut usb = configured();
    usb.pma_write(8, 2, 1000);
    usb.pma_write(10, 2, 64);
    usb.write(4, 0x8091);
    assert!(
        usb.violations[0].contains("outside the packet memory"),
        "{:?}",
        usb.violations
    );
    let mut usb = configured();
    usb.pma_write(BULK_OUT, 2, 0);
    usb.pma_write(0x400, 2, 0);
    usb.pma_write(BULK_IN, 4, 0);
    let wanted = [
        "the buffer of EP1R while it is VALID",
        "beyond its end",
        "half-words only",
    ];
    for (text, wanted) in usb.violations.iter().zip(wanted) {
        assert!(text.contains(wanted), "{text}");
    }
    assert_eq!(usb.violations.len(), 3);
}

#[test]
fn three_milliseconds_of_silence_suspend_and_any_frame_wakes() {
    let mut usb = configured();
    usb.write(ISTR, 0);
    usb.start_of_frame(7);
    usb.start_of_frame(8);
    assert_eq!(usb.read(FNR), 8 | 0xA000, "locked, D+ high");
    (0..3).for_each(|_| usb.missing_frame());
    assert_eq!(usb.read(ISTR) & 0x0900, 0x0900);
    usb.write(CNTR, 0x9C0C);
    usb.write(ISTR, 0);
    usb.missing_frame();
    assert_eq!(usb.read(ISTR), 0, "asleep");
    usb.start_of_frame(9);
    assert_eq!(usb.read(ISTR) & 0x1000, 0x1000);
    assert_eq!(usb.read(CNTR), 0x9C08, "LP_MODE goes by itself");
}

#[test]
fn registers_that_are_not_there_are_reported() {
    let mut usb = configured();
    usb.read(0x20);
    usb.write(FNR, 1);
    usb.write(BTABLE, 4);
    assert_eq!(usb.violations.len(), 3);
}
