//! Task of one device: connects, runs the session, reconnects.
//!
//! ```text
//!  searching ──► handshake ──► session (session.rs) ──► session end ──► searching …
//!      │             └ another protocol: incompatible, next attempt after 30 s
//!      └ next attempt after 0.2 s to 5 s; requests are answered meanwhile
//! ```

mod commands;
mod contact;
mod counters;
mod device_link;
mod device_lookups;
mod flood_limits;
mod heating;
mod lookup_push;
mod lookup_rows;
pub mod pot_follower;
mod reconcile;
mod recording;
mod report;
mod request;
mod session;
mod store_wait;
mod stored_session;
pub mod sweep;
mod task;
mod window_route;

pub use self::report::not_connected_error;
pub use self::request::DeviceRequest;
pub use self::task::DeviceTask;
