//! The API as it is met over a socket: by its client, by strangers, by browsers of other sites.

mod access;
mod backend;
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
mod session;
