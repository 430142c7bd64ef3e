//! A board's log: frames of numbers and values (defmt), over a debug probe or the link, and the texts for
//! them, which stay in the image's file.
//!
//! ```text
//! bytes ─► frames ─► rzcobs ─► walk (check of the lengths) ─► table ─► Message
//! ```
//!
//! [`follow`](follow::follow) runs all stages until it is stopped.

#[cfg(feature = "log")]
pub mod decoder;
#[cfg(feature = "log")]
pub mod find;
#[cfg(feature = "log")]
pub mod follow;
#[cfg(feature = "log")]
pub mod frames;
pub mod image_cache;
#[cfg(feature = "log")]
pub mod message;
#[cfg(feature = "log")]
pub mod over_link;
#[cfg(all(feature = "log", feature = "probe"))]
pub mod over_probe;
pub mod running;
#[cfg(feature = "log")]
mod rzcobs;
#[cfg(feature = "log")]
pub mod table;
#[cfg(feature = "log")]
mod walk;

#[cfg(all(test, feature = "log"))]
mod tests;
