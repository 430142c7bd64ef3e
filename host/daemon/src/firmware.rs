//! Match of a device's firmware with this daemon, and update advice.

use std::cmp::Ordering;

use ihd_shared::wire::{PROTOCOL_MAJOR, PROTOCOL_MINOR};

/// Returns update advice for a device with this minor protocol version; empty if it matches.
pub fn updates_needed(minor: u16) -> String {
    advice(minor, PROTOCOL_MINOR)
}

fn advice(theirs: u16, ours: u16) -> String {
    let older = theirs.cmp(&ours);
    let [theirs, ours] = [theirs, ours].map(|minor| format!("{PROTOCOL_MAJOR}.{minor}"));
    match older {
        Ordering::Equal => String::new(),
        Ordering::Less => format!(
            "its firmware speaks protocol {theirs}, this daemon {ours}: part of what is asked finds no answer; `ihd flash` brings it up to date"
        ),
        Ordering::Greater => format!(
            "its firmware speaks protocol {theirs}, this daemon {ours}: what is new in it is not shown; update ihd on this machine"
        ),
    }
}

/// Returns the USB serial number in an address; `None` for other addresses and for `usb`, which means any board.
pub fn usb_serial(address: &str) -> Option<&str> {
    address
        .strip_prefix("usb:")
        .filter(|serial| !serial.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_older_side_is_the_one_to_update() {
        assert_eq!(updates_needed(PROTOCOL_MINOR), "");
        assert!(advice(1, 2).contains("ihd flash"));
        assert!(advice(2, 1).contains("update ihd"));
    }

    #[test]
    fn an_address_on_usb_holds_its_serial_number() {
        assert_eq!(usb_serial("usb:0123AB"), Some("0123AB"));
        for other in [
            "usb",
            "usb:",
            "sim",
            "tcp:127.0.0.1:4711",
            "serial:/dev/ttyACM0",
        ] {
            assert_eq!(usb_serial(other), None, "{other}");
        }
    }
}
