//! Right of a daemon to its configured name.

/// Right of a daemon to its configured name.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Standing {
    /// Not yet known from the server.
    #[default]
    Unknown,
    /// The name is this store's.
    Held,
    /// The name is another store's: the reason, with both places.
    Refused(String),
}
