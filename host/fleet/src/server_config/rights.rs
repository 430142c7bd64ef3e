//! Rights of each key, as subjects (explained in docs/fleet.md).
//!
//! A key has an account of its own that imports these from the site's account. Permissions within one account would not
//! suffice: the server checks the subject of a request, not the subject of its answer, and JetStream answers with rights
//! of its own. A client that may read one key of a bucket could have the answer written to any other.

use super::EdgeAccount;
use crate::names;

/// Prefix of the subjects of Home Assistant's discovery messages.
const DISCOVERY: &str = "homeassistant.sensor";

/// Subject on which Home Assistant publishes its start.
pub(super) const HOME_ASSISTANT_STATUS: &str = crate::discovery::STATUS;

/// Figures of the whole site. Each key's account imports them, because the server would otherwise answer all of `$JS.API`
/// there by itself with "JetStream not enabled" (`serviceImportShadowed` in its accounts.go).
const ACCOUNT_INFO: &str = "$JS.API.INFO";

/// Subjects that a key's account imports from the site's account.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Rights {
    /// Subjects that it may publish to; only this account receives the answers.
    pub services: Vec<String>,
    /// Subjects that it may subscribe to.
    pub streams: Vec<String>,
}

/// Returns services and streams that the site's account exports; [`edge`] and [`worker`] list the imports.
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
    // Only messages of the site's own users arrive, not those of another key: the server forwards no message twice.
    let streams = vec![put(names::LOOKUPS, "*"), HOME_ASSISTANT_STATUS.into()];
    (services, streams)
}

/// Returns the service with many answers to one request: pull consumers.
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

/// Returns the rights of a daemon, for its hobs.
pub fn edge(edge: &EdgeAccount) -> Rights {
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

/// Adds the rights for the fleet's page: cards and lengths of streams; no lookup, no window, no result.
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

/// Returns the rights of a worker.
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

/// Rights to pull from a consumer and to acknowledge.
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

/// Right to read the dead letters of a hob.
fn dead_of(hob: &str) -> String {
    let window = names::dead_letter(hob, "*", "*");
    format!("$JS.API.DIRECT.GET.{}.{window}", names::DEAD)
}

/// Right to write a key of a bucket; as a stream, to receive its changes.
fn put(bucket: &str, key: &str) -> String {
    names::key(bucket, key)
}

/// Right to read a key of a bucket.
fn get(bucket: &str, key: &str) -> String {
    format!("{}.{}", list(bucket), names::key(bucket, key))
}

/// Right to read every key of a bucket, one after the other.
fn list(bucket: &str) -> String {
    format!("$JS.API.DIRECT.GET.{}", names::bucket_stream(bucket))
}

fn info_bucket(bucket: &str) -> String {
    info(&names::bucket_stream(bucket))
}

fn info(stream: &str) -> String {
    format!("$JS.API.STREAM.INFO.{stream}")
}
