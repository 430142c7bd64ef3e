//! Protocol 1.x, which recordings still hold: what 2.0 appended to its messages.
//!
//! All that 2.0 changed of a message stands behind its old fields, so that an old payload with what is
//! missing is a new one. An old `Faulted` has `LockedOut`'s number.

use std::borrow::Cow;

use ihd_shared::sampling::Scales;
use ihd_shared::wire::messages::{
    Limit, Message, NO_PANEL, NO_SENSOR_C, Status, Telemetry, WindowStart,
};

/// The major version.
pub const MAJOR: u16 = 1;

/// The payload of message `id`, with what 2.0 appended.
pub fn completed(id: u8, payload: &[u8]) -> Cow<'_, [u8]> {
    let mut buf = [0; 32];
    let appended = match id {
        WindowStart::ID => {
            let scales = Scales::OF_PROTOCOL_1;
            postcard::to_slice(&(scales.v_full_scale_mv, scales.i_full_scale_ma), &mut buf)
        }
        // Asked power, limit, bus, coil voltage, current at a turn-off.
        Telemetry::ID => postcard::to_slice(&(0u16, Limit::None, 0u16, 0u16, 0i32), &mut buf),
        // Limit, tries, three temperatures, fan, panel, its lock.
        Status::ID => {
            let temperatures = [NO_SENSOR_C; 3];
            let fields = (Limit::None, 0u8, temperatures, false, NO_PANEL, false);
            postcard::to_slice(&fields, &mut buf)
        }
        _ => return Cow::Borrowed(payload),
    };
    match appended {
        Ok(appended) => Cow::Owned([payload, appended].concat()),
        // They take at most 18 bytes of the buffer.
        Err(_) => Cow::Borrowed(payload),
    }
}
