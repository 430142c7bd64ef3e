//! Who may do what: tokens and roles, names of this machine, and the check of every request.

pub(crate) mod cookie;
pub(crate) mod guard;
pub mod hosts;
pub(crate) mod sessions;
pub mod tokens;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a token is good for; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Look: every `GET`.
    Read,
    /// Command devices, and make backups.
    Operate,
    /// Replace a device's firmware. No route needs it yet.
    Flash,
}

impl Role {
    /// Every role, lowest first.
    pub const ALL: [Role; 3] = [Role::Read, Role::Operate, Role::Flash];

    /// Its word in the token file.
    pub fn name(self) -> &'static str {
        match self {
            Role::Read => "read",
            Role::Operate => "operate",
            Role::Flash => "flash",
        }
    }

    /// The role of a word.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }
}
