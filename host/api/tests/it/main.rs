//! Tests of the API over a socket: its client, clients without a token, pages of other sites.

mod access;
mod client;
mod description;
mod events;
mod fleet;
mod greedy;
mod http;
mod http2;
mod live;
mod page;
mod past;
mod recordings;
mod rig;
mod session;
