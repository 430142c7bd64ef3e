//! What the daemon keeps.
