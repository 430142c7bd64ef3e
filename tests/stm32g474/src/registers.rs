//! Addresses, reset values and fields of the registers, from ST's SVD (svd/make_registers.py).

/// Field of a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Field {
    /// Address of the register.
    pub address: u32,
    bit: u32,
    width: u32,
}

impl Field {
    /// Field of `width` bits from `bit` of the register at `address`.
    pub const fn new(address: u32, bit: u32, width: u32) -> Self {
        Self {
            address,
            bit,
            width,
        }
    }

    /// Field with the same bits in another register.
    pub const fn at(self, address: u32) -> Self {
        Self { address, ..self }
    }

    /// Mask of the field's bits in the register.
    pub const fn mask(self) -> u32 {
        (((1u64 << self.width) - 1) << self.bit) as u32
    }

    /// Extracts the field from a register's value.
    pub const fn extract(self, register: u32) -> u32 {
        (register & self.mask()) >> self.bit
    }

    /// Value of a register with another value of this field.
    pub const fn put(self, register: u32, value: u32) -> u32 {
        (register & !self.mask()) | ((value << self.bit) & self.mask())
    }
}

/// Register of the SVD.
#[derive(Clone, Copy, Debug)]
pub struct Register {
    /// Peripheral of the register.
    pub peripheral: &'static str,
    /// Name in the reference manual, without the peripheral.
    pub name: &'static str,
    /// Address of the register.
    pub address: u32,
    /// Value after reset.
    pub reset: u32,
    /// Bits that are not reserved.
    pub bits: u32,
    /// Bits that a program may write.
    pub writable: u32,
}

#[allow(
    missing_docs,
    clippy::all,
    unused_imports,
    reason = "generated from the SVD"
)]
mod generated {
    use super::{Field, Register};
    include!(concat!(env!("OUT_DIR"), "/registers.rs"));
}
pub use generated::*;
