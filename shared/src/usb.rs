//! USB interface: identification of the controller, sizes of packets and transfers.

use crate::wire::frame::MAX_ENCODED;

/// pid.codes' vendor id, with its product id for tests and prototypes: a product needs its own.
pub const VENDOR_ID: u16 = 0x1209;

/// See [`VENDOR_ID`].
pub const PRODUCT_ID: u16 = 0x0001;

/// Beginning of the product string; others share the prototypes' product id.
pub const PRODUCT: &str = "ihd induction-hob controller";

/// Bytes of a full-speed bulk packet.
pub const PACKET: usize = 64;

/// Bytes of a transfer: the longest frame in whole packets. Either side ends a frame, and with it the transfer, with a short packet or
/// with the transfer's last byte.
pub const TRANSFER: usize = MAX_ENCODED.next_multiple_of(PACKET);
