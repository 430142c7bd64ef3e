//! `ihd-study` as a user calls it, and the accuracy that its studies promise.

mod accuracy;
mod documented;
#[path = "../../../ihd/tests/it/documents.rs"]
mod documents;
mod hostile;
mod map;
mod paper;
mod usage;
