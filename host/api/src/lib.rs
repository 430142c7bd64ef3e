//! The daemon over HTTP.
