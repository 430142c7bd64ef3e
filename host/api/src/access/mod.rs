//! Access control: tokens, roles, browser sessions, host names, and the checks of every request.

pub(crate) mod cookie;
pub(crate) mod guard;
pub mod hosts;
pub(crate) mod served_tokens;
pub(crate) mod sessions;
pub mod tokens;
