//! By what a host finds the controller on USB.

/// pid.codes' vendor id, with its product id for tests and prototypes: a product needs its own.
pub const VENDOR_ID: u16 = 0x1209;

/// See [`VENDOR_ID`].
pub const PRODUCT_ID: u16 = 0x0001;

/// Beginning of the product string; others share the prototypes' product id.
pub const PRODUCT: &str = "ihd induction-hob controller";
