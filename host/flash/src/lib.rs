//! Puts the firmware's image on a board, and reads its log.

pub mod log;
