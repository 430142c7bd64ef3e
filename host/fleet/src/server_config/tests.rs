use super::*;
use crate::names;

fn site() -> Site {
    let mut first: EdgeAccount = "lab-1=hob-a,hob-b".parse().unwrap();
    first.sees_fleet = true;
    Site::new("lab", vec![first, "lab-2=hob-c".parse().unwrap()], 2)
}

fn server() -> ServerSettings {
    ServerSettings {
        name: "lab".into(),
        listen: "0.0.0.0:4222".into(),
        mqtt_listen: Some("0.0.0.0:8883".into()),
        store: "/var/lib/nats".into(),
        tls: Some(TlsFiles {
            certificate: "/etc/nats/certificate.pem".into(),
            key: "/etc/nats/key.pem".into(),
        }),
    }
}

fn keys(sites: &[Site]) -> BTreeMap<String, UserKey> {
    let names = sites.iter().flat_map(|site| site.key_names(true));
    names.map(|name| (name, UserKey::make().unwrap())).collect()
}

fn config(sites: &[Site]) -> Result<String, ServerConfigError> {
    server_config(&server(), sites, &keys(sites))
}

/// Matches as NATS does: `*` is one token, `>` at the end is one or more.
fn covers(pattern: &str, subject: &str) -> bool {
    let mut tokens = subject.split('.');
    for part in pattern.split('.') {
        match (part, tokens.next()) {
            (_, None) => return false,
            (">", Some(_)) => return true,
            ("*", Some(_)) => {}
            (part, Some(token)) if part == token => {}
            _ => return false,
        }
    }
    tokens.next().is_none()
}

#[test]
fn subjects_are_compared_as_the_server_does() {
    for (pattern, subject, covered) in [
        ("a.b", "a.b", true),
        ("a.*", "a.b", true),
        ("a.*", "a.b.c", false),
        ("a.>", "a.b.c", true),
        ("a.>", "a", false),
        ("a.b", "a", false),
    ] {
        assert_eq!(covers(pattern, subject), covered, "{pattern} {subject}");
    }
}

/// Returns `true` if one of the rights covers a subject.
fn may(rights: &Rights, subject: &str) -> bool {
    rights.services.iter().any(|right| covers(right, subject))
}

#[test]
fn an_edge_may_write_what_is_its_hobs_and_nothing_of_others() {
    let site = site();
    let rights = rights::edge(&site.edges[0]);
    for (own, other) in [("hob-a", "hob-c"), ("hob-b", "hob-c"), ("hob-a", "*")] {
        for subject in [
            names::window as fn(String) -> String,
            names::event,
            names::state,
            |hob| names::result(hob, 1, 2),
            |hob| format!("$KV.ihd_lookups.{hob}"),
            |hob| format!("$KV.ihd_hobs.{hob}"),
            |hob| format!("$KV.ihd_pots.{hob}"),
            |hob| format!("$JS.API.DIRECT.GET.KV_ihd_lookups.$KV.ihd_lookups.{hob}"),
            |hob| format!("homeassistant.sensor.ihd_{hob}.power.config"),
            |hob| format!("$JS.API.DIRECT.GET.IHD_DEAD.ihd.v2.{hob}.dead.1.2"),
        ] {
            assert!(
                may(&rights, &subject(own.into())),
                "{}",
                subject(own.into())
            );
            let of_other = subject(other.into());
            assert!(!may(&rights, &of_other), "{of_other}");
        }
    }
}

#[test]
fn an_edge_may_claim_its_own_name_alone() {
    let rights = rights::edge(&site().edges[0]);
    for subject in [
        "$KV.ihd_claims.",
        "$JS.API.DIRECT.GET.KV_ihd_claims.$KV.ihd_claims.",
        "$KV.ihd_edges.",
    ] {
        assert!(may(&rights, &format!("{subject}lab-1")), "{subject}");
        assert!(!may(&rights, &format!("{subject}lab-2")), "{subject}");
    }
    assert!(may(&rights, "$KV.ihd_edges.lab-1.refused"));
    assert!(!may(&rights, "$KV.ihd_edges.lab-2.refused"));
    assert!(!may(&rights, "$JS.API.DIRECT.GET.KV_ihd_claims"));
}

#[test]
fn no_key_may_change_streams_make_consumers_or_put_settings() {
    let site = site();
    let mut all: Vec<Rights> = site.edges.iter().map(rights::edge).collect();
    all.extend(site.workers.iter().map(|name| rights::worker(name)));
    for rights in &all {
        for request in [
            "STREAM.CREATE.IHD_WINDOWS",
            "STREAM.UPDATE.IHD_WINDOWS",
            "STREAM.DELETE.IHD_WINDOWS",
            "STREAM.PURGE.IHD_WINDOWS",
            "STREAM.MSG.DELETE.IHD_WINDOWS",
            "STREAM.MSG.GET.IHD_WINDOWS",
            "STREAM.SNAPSHOT.IHD_WINDOWS",
            "STREAM.RESTORE.IHD_WINDOWS",
            "STREAM.NAMES",
            "CONSUMER.CREATE.IHD_RESULTS",
            "CONSUMER.CREATE.IHD_RESULTS.mine",
            "CONSUMER.CREATE.IHD_RESULTS.mine.ihd.v2.hob-a.result.>",
            "CONSUMER.DURABLE.CREATE.IHD_RESULTS.mine",
            "CONSUMER.DELETE.IHD_RESULTS.edge-lab-1",
            "CONSUMER.PAUSE.IHD_RESULTS.edge-lab-1",
            "DIRECT.GET.KV_ihd_lookups",
            "DIRECT.GET.IHD_WINDOWS",
            "DIRECT.GET.IHD_DEAD",
        ] {
            assert!(!may(rights, &format!("$JS.API.{request}")), "{request}");
        }
        assert!(!may(rights, "$KV.ihd_settings.limits"));
        assert!(!may(rights, "$O.ihd_captures.C.x"));
        // An answer may be requested at any subject; none may reach the site's own.
        assert!(!may(rights, "_INBOX.x"));
    }
}

#[test]
fn what_a_key_may_do_is_offered_by_the_site() {
    let site = site();
    let (mut services, streams) = rights::offered();
    services.push(rights::offered_with_many_answers().to_owned());
    let edges = site.edges.iter().map(rights::edge);
    let workers = site.workers.iter().map(|name| rights::worker(name));
    for rights in edges.chain(workers) {
        for (imported, offered) in [(&rights.services, &services), (&rights.streams, &streams)] {
            for subject in imported {
                let is_offered = offered.iter().any(|pattern| covers(pattern, subject));
                assert!(is_offered, "{subject}");
            }
        }
    }
}

#[test]
fn names_that_would_be_another_subject_are_refused() {
    for name in ["", "*", ">", "a.b", "a b", "a\n", "a\"", "ü", "$SYS"] {
        let mut wrong = site();
        wrong.edges[0].hobs[0] = name.into();
        assert!(matches!(
            config(&[wrong]),
            Err(ServerConfigError::Name { what: "hob", .. })
        ));
        let mut wrong = site();
        wrong.edges[0].name = name.into();
        assert!(matches!(
            config(&[wrong]),
            Err(ServerConfigError::Name { what: "edge", .. })
        ));
        let mut wrong = site();
        wrong.workers[0] = name.into();
        assert!(matches!(
            config(&[wrong]),
            Err(ServerConfigError::Name { what: "worker", .. })
        ));
        let mut wrong = site();
        wrong.name = name.into();
        assert!(matches!(
            config(&[wrong]),
            Err(ServerConfigError::Name { what: "site", .. })
        ));
    }
    assert!(config(&[site()]).is_ok());
}

#[test]
fn one_hob_is_at_one_edge_and_one_name_is_one() {
    let twice = |change: fn(&mut Site)| {
        let mut site = site();
        change(&mut site);
        match config(&[site]) {
            Err(ServerConfigError::Twice { what, name }) => format!("{what} {name}"),
            other => format!("{other:?}"),
        }
    };
    assert_eq!(twice(|s| s.edges[1].hobs[0] = "hob-b".into()), "hob hob-b");
    assert_eq!(twice(|s| s.edges[1].name = "lab-1".into()), "edge lab-1");
    assert_eq!(
        twice(|s| s.workers[1] = "worker-1".into()),
        "worker worker-1"
    );
    let two = config(&[site(), site()]);
    let what = "site";
    let name = "lab".to_owned();
    assert_eq!(two, Err(ServerConfigError::Twice { what, name }));
}

#[test]
fn an_edge_is_written_with_its_hobs() {
    let edge: EdgeAccount = "lab-1=hob-a,hob-b".parse().unwrap();
    assert_eq!((edge.name.as_str(), edge.hobs.len()), ("lab-1", 2));
    assert!(!edge.sees_fleet);
    for wrong in [
        "",
        "lab-1",
        "lab-1=",
        "=hob-a",
        "lab-1=hob-a,",
        "lab.1=hob-a",
    ] {
        assert!(wrong.parse::<EdgeAccount>().is_err(), "{wrong}");
    }
}

#[test]
fn seeds_are_in_the_configuration_for_mqtt_alone_and_a_key_that_is_missing_is_named() {
    let sites = [site()];
    let mut keys = keys(&sites);
    let text = server_config(&server(), &sites, &keys).unwrap();
    for (name, key) in &keys {
        let has_password = name.ends_with("-mqtt") || name.ends_with("-home-assistant");
        assert_eq!(text.contains(key.seed()), has_password, "{name}");
        assert_eq!(text.contains(key.public()), !has_password, "{name}");
    }
    let without = ServerSettings {
        mqtt_listen: None,
        ..server()
    };
    let text = server_config(&without, &sites, &keys).unwrap();
    assert!(keys.values().all(|key| !text.contains(key.seed())));
    assert!(!text.contains("mqtt"), "{text}");
    keys.remove("lab-edge-lab-2");
    let missing = server_config(&server(), &sites, &keys);
    assert_eq!(
        missing,
        Err(ServerConfigError::NoKey("lab-edge-lab-2".into()))
    );
}

#[test]
fn a_path_is_written_as_it_is_or_refused() {
    let at = |store: &str| {
        let server = ServerSettings {
            store: store.into(),
            ..server()
        };
        server_config(&server, &[], &BTreeMap::new())
    };
    let windows = at(r"C:\nats\new").unwrap();
    assert!(windows.contains(r"store_dir: 'C:\nats\new'"), "{windows}");
    for wrong in ["", "a\nb", "it's"] {
        assert!(
            matches!(at(wrong), Err(ServerConfigError::Path(_))),
            "{wrong}"
        );
    }
}
