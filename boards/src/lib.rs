//! Board files: the values of a power stage and its sensors.
//!
//! ```text
//! boards/NAME.toml ─► Board::read ─► values (each in its range) ─► scales ─► order (limits below one another), pins, thermistors ─► constants
//! ```

mod board;
mod error;
mod order;
mod pins;
mod scales;
mod thermistors;
mod values;

pub use board::Board;
pub use error::BoardError;
