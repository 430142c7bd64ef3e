//! Decoding of protocols 1.x and 2.x, which recordings still hold.
//!
//! Version 2.0 appended fields to messages: an old payload with the missing fields appended is a valid new one. An old `Faulted`
//! has the number of `LockedOut`. Version 3.0 changed requests and answers only, which a reader of recordings skips.

use std::borrow::Cow;

use ihd_shared::sampling::Scales;
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::messages::{Limit, Message, Telemetry, WindowStart};

/// Returns `true` if recordings of this major version can be read; its devices cannot be connected to.
pub fn is_older(major: u16) -> bool {
    (1..PROTOCOL_MAJOR).contains(&major)
}

/// Returns the payload of message `id` of this major version, with the fields that later versions appended.
pub fn upgraded_payload(major: u16, id: u8, payload: &[u8]) -> Cow<'_, [u8]> {
    let mut buf = [0; 32];
    let appended = match id {
        _ if major > 1 => return Cow::Borrowed(payload),
        WindowStart::ID => {
            let scales = Scales::OF_PROTOCOL_1;
            postcard::to_slice(&(scales.v_full_scale_mv, scales.i_full_scale_ma), &mut buf)
        }
        // Requested power, limit, bus, coil voltage, current at a turn-off.
        Telemetry::ID => postcard::to_slice(&(0u16, Limit::None, 0u16, 0u16, 0i32), &mut buf),
        _ => return Cow::Borrowed(payload),
    };
    match appended {
        Ok(appended) => Cow::Owned([payload, appended].concat()),
        // They take at most 18 bytes of the buffer.
        Err(_) => Cow::Borrowed(payload),
    }
}
