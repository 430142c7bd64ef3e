//! Protocols 1.x and 2.x, which recordings still hold.
//!
//! What 2.0 changed of a message stands behind its old fields, so that an old payload with what is missing is a new one; an old
//! `Faulted` has `LockedOut`'s number. What 3.0 changed are requests and answers alone, which a reader of recordings leaves
//! out.

use std::borrow::Cow;

use ihd_shared::sampling::Scales;
use ihd_shared::wire::PROTOCOL_MAJOR;
use ihd_shared::wire::messages::{Limit, Message, Telemetry, WindowStart};

/// Whether recordings of this major version are read, though its devices are not talked to.
pub fn is_older(major: u16) -> bool {
    (1..PROTOCOL_MAJOR).contains(&major)
}

/// The payload of message `id` of this major version, with what later ones appended.
pub fn completed(major: u16, id: u8, payload: &[u8]) -> Cow<'_, [u8]> {
    let mut buf = [0; 32];
    let appended = match id {
        _ if major > 1 => return Cow::Borrowed(payload),
        WindowStart::ID => {
            let scales = Scales::OF_PROTOCOL_1;
            postcard::to_slice(&(scales.v_full_scale_mv, scales.i_full_scale_ma), &mut buf)
        }
        // Asked power, limit, bus, coil voltage, current at a turn-off.
        Telemetry::ID => postcard::to_slice(&(0u16, Limit::None, 0u16, 0u16, 0i32), &mut buf),
        _ => return Cow::Borrowed(payload),
    };
    match appended {
        Ok(appended) => Cow::Owned([payload, appended].concat()),
        // They take at most 18 bytes of the buffer.
        Err(_) => Cow::Borrowed(payload),
    }
}
