//! Roles of tokens.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Rights of a token; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read: every `GET`.
    Read,
    /// Command devices and create backups.
    Operate,
}

impl Role {
    /// All roles, lowest first.
    pub const ALL: [Role; 2] = [Role::Read, Role::Operate];

    /// Returns its name in the token file.
    pub fn name(self) -> &'static str {
        match self {
            Role::Read => "read",
            Role::Operate => "operate",
        }
    }

    /// Returns the role of a name; `None` if there is no such role.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|role| role.name() == name)
    }
}
