//! What each key may do, as subjects (docs/fleet-security.md has it in words).
//!
//! A key has an account of its own that imports these from the site's account. Permissions within one account would not
//! do: the server looks at the subject of a request, not at the one that asks to be answered, and JetStream answers with
//! rights of its own. Whoever may read one key of a bucket could have the answer written to any other.

use super::Edge;
use crate::names;

/// Prefix of the topics by which Home Assistant learns of sensors.
const DISCOVERY: &str = "homeassistant.sensor";

/// Where Home Assistant says that it has started.
pub(super) const HOME_ASSISTANT_STATUS: &str = crate::discovery::STATUS;

/// Figures of the site as a whole. Each key's account has them, because the server would else answer all of `$JS.API` there
/// by itself, first, with "JetStream not enabled" (`serviceImportShadowed` in its accounts.go).
const ACCOUNT_INFO: &str = "$JS.API.INFO";

/// Subjects that an account takes from the site's.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rights {
    /// What it may send; answers come back to it alone.
    pub services: Vec<String>,
    /// What it may listen to.
    pub streams: Vec<String>,
}

/// What the site's account offers; who imports what is in [`edge`] and [`worker`].
pub(super) fn offered() -> (Vec<String>, Vec<String>) {
    let mut services: Vec<String> = vec![
        names::window("*"),
        names::results("*"),
        names::event("*"),
        names::state("*"),
        all_dead(),
        format!("{DISCOVERY}.*.*.config"),
        dead_of("*"),
        put(names::EDGES, &names::refused_edge("*")),
        ACCOUNT_INFO.into(),
        "$JS.API.STREAM.INFO.*".into(),
        "$JS.API.CONSUMER.INFO.*.*".into(),
        "$JS.ACK.*.*.>".into(),
    ];
    for bucket in BUCKETS {
        services.push(put(bucket, "*"));
        services.push(get(bucket, "*"));
        services.push(list(bucket));
    }
    // Heard of what the site's own users publish, not of what comes from another key: the server passes no message on twice.
    let streams = vec![put(names::LOOKUPS, "*"), HOME_ASSISTANT_STATUS.into()];
    (services, streams)
}

/// What is answered by many messages: the requests of pull consumers.
pub(super) fn offered_with_many_answers() -> &'static str {
    "$JS.API.CONSUMER.MSG.NEXT.*.*"
}

const BUCKETS: [&str; 7] = [
    names::LOOKUPS,
    names::HOBS,
    names::EDGES,
    names::CLAIMS,
    names::WORKER_CARDS,
    names::POTS,
    names::SETTINGS,
];

/// What a daemon may do for its hobs.
pub fn edge(edge: &Edge) -> Rights {
    let mut rights = Rights::default();
    let services = &mut rights.services;
    for hob in &edge.hobs {
        services.extend([
            names::window(hob),
            names::results(hob),
            names::event(hob),
            names::state(hob),
            format!("{DISCOVERY}.ihd_{hob}.*.config"),
            dead_of(hob),
        ]);
        for bucket in [names::LOOKUPS, names::HOBS, names::POTS] {
            services.extend([put(bucket, hob), get(bucket, hob)]);
        }
        rights.streams.push(put(names::LOOKUPS, hob));
    }
    services.push(ACCOUNT_INFO.into());
    for bucket in [names::EDGES, names::CLAIMS] {
        services.extend([put(bucket, &edge.name), get(bucket, &edge.name)]);
    }
    services.push(put(names::EDGES, &names::refused_edge(&edge.name)));
    services.extend([get(names::SETTINGS, "*"), list(names::SETTINGS)]);
    services.push(list(names::POTS));
    let read = [names::LOOKUPS, names::HOBS, names::EDGES, names::POTS];
    services.extend(read.into_iter().chain([names::SETTINGS]).map(info_bucket));
    services.extend(consumer(names::RESULTS, &names::edge_consumer(&edge.name)));
    rights.streams.push(HOME_ASSISTANT_STATUS.into());
    if edge.sees_fleet {
        see_fleet(&mut rights);
    }
    rights
}

/// What the fleet's page shows: who is there, and how much waits. No lookup, no window, no result.
fn see_fleet(rights: &mut Rights) {
    let cards = [names::HOBS, names::EDGES, names::WORKER_CARDS];
    rights.services.extend(cards.map(list));
    rights.services.push(info_bucket(names::WORKER_CARDS));
    let streams = [names::WINDOWS, names::RESULTS, names::EVENTS, names::DEAD];
    rights.services.extend(streams.map(info));
    let workers = format!(
        "$JS.API.CONSUMER.INFO.{}.{}",
        names::WINDOWS,
        names::WORKERS
    );
    rights.services.push(workers);
}

/// What a worker may do.
pub fn worker(name: &str) -> Rights {
    let mut services = consumer(names::WINDOWS, names::WORKERS).to_vec();
    services.extend([
        ACCOUNT_INFO.into(),
        names::results("*"),
        all_dead(),
        put(names::WORKER_CARDS, name),
        get(names::WORKER_CARDS, name),
        get(names::SETTINGS, "*"),
        list(names::SETTINGS),
        get(names::POTS, "*"),
        list(names::POTS),
    ]);
    let read = [names::WORKER_CARDS, names::SETTINGS, names::POTS];
    services.extend(read.map(info_bucket));
    Rights {
        services,
        streams: Vec::new(),
    }
}

/// To pull from a consumer, and to acknowledge.
fn consumer(stream: &str, name: &str) -> [String; 3] {
    [
        format!("$JS.API.CONSUMER.INFO.{stream}.{name}"),
        format!("$JS.API.CONSUMER.MSG.NEXT.{stream}.{name}"),
        format!("$JS.ACK.{stream}.{name}.>"),
    ]
}

/// Subjects of windows that were given up.
fn all_dead() -> String {
    format!("ihd.{}.*.dead.>", names::WIRE)
}

/// To look whether windows of a hob were given up.
fn dead_of(hob: &str) -> String {
    let window = names::dead(hob, "*", "*");
    format!("$JS.API.DIRECT.GET.{}.{window}", names::DEAD)
}

/// To write a key of a bucket; also where listeners hear of it.
fn put(bucket: &str, key: &str) -> String {
    names::key(bucket, key)
}

/// To read a key of a bucket.
fn get(bucket: &str, key: &str) -> String {
    format!("{}.{}", list(bucket), names::key(bucket, key))
}

/// To read every key of a bucket, one after the other.
fn list(bucket: &str) -> String {
    format!("$JS.API.DIRECT.GET.{}", names::bucket_stream(bucket))
}

fn info_bucket(bucket: &str) -> String {
    info(&names::bucket_stream(bucket))
}

fn info(stream: &str) -> String {
    format!("$JS.API.STREAM.INFO.{stream}")
}
