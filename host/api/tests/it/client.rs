//! The client against the server: every route, every error, TLS.

use std::path::{Path, PathBuf};
use std::time::Duration;

use ihd_api::ApiClient;
use ihd_api::access::tokens::Tokens;
use ihd_api::client::ClientError;
use ihd_api::tls::Certificate;
use ihd_model::Role;
use ihd_model::{Command, CommandError, Quantity, RecordSettings, Trigger};
use ihd_shared::lookup::{RlLookup, prior::prior};

use crate::http::PATIENCE;
use crate::rig::{NAME, OTHER, Running};

fn client(server: &Running, holder: &str) -> ApiClient {
    ApiClient::new(&server.url, holder, None, &[]).unwrap()
}

#[test]
fn every_route_has_a_method_that_works() {
    let mut server = Running::with_hobs(|_, _| {});
    let ada = client(&server, "Ada");
    assert!(ada.health(PATIENCE).unwrap().store);
    let devices = ada.devices().unwrap();
    assert_eq!([&devices[0].name, &devices[1].name], [NAME, OTHER]);
    let device = ada.device(NAME).unwrap();
    assert_eq!(
        (&device.name, &device.identity),
        (&devices[0].name, &devices[0].identity)
    );
    let lookup = &ada.lookups(NAME).unwrap()[0];
    assert_eq!(
        (&*lookup.state, &*lookup.blob),
        ("active", &prior().to_bytes()[..])
    );
    assert_eq!(ada.results(NAME, 7, Some(i64::MAX)).unwrap(), []);
    assert_eq!(ada.take_lease(NAME, false).unwrap().holder, "Ada");
    let pushed = RlLookup {
        version: 1,
        ..prior()
    };
    let trigger = Trigger::Level {
        quantity: Quantity::Inductance,
        level: 28.5,
        rising: false,
    };
    let sweep = vec![700, 1_000];
    let blob = pushed.to_bytes().to_vec();
    let triggered = RecordSettings {
        trigger,
        pre_trigger_s: 2.5,
        duration_s: Some(30.0),
        max_bytes: Some(1_000_000),
    };
    // Each with its text in the audit and the start of its answer; empty if the device refuses.
    for (command, text, answer) in [
        (
            Command::Power { power_w: 1_200 },
            "power 1200 W",
            "1200 W asked for",
        ),
        (Command::Off, "off", "off"),
        (Command::ClearFault, "clear-fault", "fault cleared"),
        (
            Command::LookupPush { blob: blob.clone() },
            &format!("lookup push ({} bytes)", blob.len()),
            "version 1 is active",
        ),
        (
            Command::LookupRollback { version: None },
            "lookup rollback",
            "version 2 is active",
        ),
        (
            Command::LookupRollback { version: Some(9) },
            "lookup rollback to version 9",
            "",
        ),
        (Command::LookupReset, "lookup reset", "back to the built-in"),
        (
            Command::Sweep { powers_w: sweep },
            "sweep 700, 1000 W",
            "sweep through 2 powers",
        ),
        (
            Command::RecordStart(RecordSettings::default()),
            "record start",
            "recording",
        ),
        (
            Command::RecordStart(triggered),
            &format!("record start at {trigger}"),
            "",
        ),
        (Command::RecordStop, "record stop", "recorded"),
    ] {
        match ada.command(NAME, &command) {
            Ok(reply) if !answer.is_empty() => {
                assert!(reply.text.starts_with(answer), "{command:?}: {reply:?}");
            }
            Err(ClientError::Command(CommandError::Refused { .. })) if answer.is_empty() => {}
            other => panic!("{command:?}: {other:?}"),
        }
        let audited = [("Ada".to_owned(), text.to_owned())];
        assert_eq!(server.commands(), audited, "{command:?}");
    }
    ada.release_lease(NAME).unwrap();
    assert_eq!(ada.device(NAME).unwrap().lease, None);
    assert!(ada.backup("monday").unwrap().path.ends_with("monday"));
}

#[test]
fn errors_of_the_daemon_arrive_as_such() {
    let server = Running::start();
    let (ada, bob) = (client(&server, "Ada"), client(&server, "Bob"));
    ada.take_lease(NAME, false).unwrap();
    let leased = |result: Result<_, ClientError>| match result {
        Err(ClientError::Command(CommandError::Leased { holder, .. })) => assert_eq!(holder, "Ada"),
        other => panic!("{other:?}"),
    };
    leased(bob.take_lease(NAME, false).map(drop));
    leased(bob.command(NAME, &Command::ClearFault).map(drop));
    leased(bob.release_lease(NAME));
    assert_eq!(bob.take_lease(NAME, true).unwrap().holder, "Bob");
    match ada.device("nobody").unwrap_err() {
        ClientError::Command(CommandError::NoDevice { name }) => assert_eq!(name, "nobody"),
        other => panic!("{other}"),
    }
}

#[test]
fn nobody_and_somebody_else_are_told_apart() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = port.local_addr().unwrap();
    let client = ApiClient::new(&format!("http://{address}"), "me", None, &[]).unwrap();
    // A server that accepts the connection and sends nothing.
    let silent = client.health(Duration::from_millis(300)).unwrap_err();
    assert!(
        matches!(silent, ClientError::Unreachable { .. }),
        "{silent}"
    );
    // An HTTP server that is not a daemon.
    let other = std::thread::spawn(move || {
        for _ in 0..2 {
            let (mut stream, _) = port.accept().unwrap();
            use std::io::{Read, Write};
            let mut request = [0; 1024];
            let _ = stream.read(&mut request);
            let _ = stream.write_all(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}");
        }
    });
    // The first connection is that of the unanswered request.
    let strange = client.health(Duration::from_millis(2000)).unwrap_err();
    assert!(
        matches!(strange, ClientError::UnexpectedResponse { .. }),
        "{strange}"
    );
    other.join().unwrap();
    let nobody = client.health(Duration::from_millis(300)).unwrap_err();
    assert!(
        matches!(nobody, ClientError::Unreachable { .. }),
        "{nobody}"
    );
}

#[test]
fn over_tls_with_its_certificate_and_a_token_and_not_without() {
    let server = Running::with_hobs(|options, dir| {
        options.token_file = Some(dir.join("tokens"));
        options.tls = Some(Certificate::Generated {
            folder: dir.join("tls"),
        });
    });
    assert!(server.url.starts_with("https://"), "{}", server.url);
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    let token = |role| tokens.at_least(role).map(str::to_owned);
    let ca = server.certificate.as_slice();
    let ada = ApiClient::new(&server.url, "Ada", token(Role::Operate), ca).unwrap();
    assert_eq!(ada.devices().unwrap().len(), 2);
    ada.command(NAME, &Command::Off).unwrap();
    ada.take_lease(NAME, false).unwrap();
    ada.release_lease(NAME).unwrap();
    assert!(ada.events(None).unwrap().next().unwrap().is_ok());
    let reader = ApiClient::new(&server.url, "Bob", token(Role::Read), ca).unwrap();
    match reader.command(NAME, &Command::Off).unwrap_err() {
        ClientError::Refused {
            status, problem, ..
        } => {
            assert_eq!((status, problem.error.as_str()), (403, "role"));
        }
        other => panic!("{other}"),
    }
    // Without `ca` the certificate is not trusted.
    let stranger = ApiClient::new(&server.url, "Eve", token(Role::Read), &[]).unwrap();
    let refused = stranger.devices().unwrap_err();
    assert!(
        matches!(refused, ClientError::Unreachable { .. }),
        "{refused}"
    );
    // Plain HTTP to a TLS port gets no response.
    let plain = server.url.replace("https", "http");
    let plain = ApiClient::new(&plain, "Eve", None, &[]).unwrap();
    assert!(plain.devices().is_err());
}

/// Writes a self-signed certificate for a name that no test connects to, and its key, to `certificate.pem` and `key.pem`.
fn write_certificate(folder: &Path, until_year: i32) {
    let key = rcgen::KeyPair::generate().unwrap();
    let mut params = rcgen::CertificateParams::new(vec!["hob.lan".into()]).unwrap();
    params.not_after = rcgen::date_time_ymd(until_year, 1, 1);
    let certificate = params.self_signed(&key).unwrap().pem();
    std::fs::write(folder.join("key.pem"), key.serialize_pem()).unwrap();
    std::fs::write(folder.join("certificate.pem"), certificate).unwrap();
}

#[test]
fn off_reaches_a_hob_whatever_date_and_name_the_certificate_has_and_after_its_renewal() {
    let mut source = None;
    let server = Running::with_hobs(|options, dir| {
        write_certificate(dir, 2001);
        options.tls = Some(Certificate::Files {
            certificate: dir.join("certificate.pem"),
            key: dir.join("key.pem"),
            folder: dir.join("tls"),
        });
        source.clone_from(&options.tls);
    });
    let (source, dir) = (source.unwrap(), server.dir.path());
    let trusted = [source.files().0, source.in_use()];
    let off = |trusted: &[PathBuf]| {
        let client = ApiClient::new(&server.url, "Ada", None, trusted).unwrap();
        client.command(NAME, &Command::Off).map(drop)
    };
    off(&trusted[..1]).expect("expired, and for another name");
    // Renewed: the next connection gets the new one.
    write_certificate(dir, 2200);
    off(&trusted[..1]).expect("renewed");
    // Renewed without the key: the one before stays in use, and its file tells which.
    let key = std::fs::read(dir.join("key.pem")).unwrap();
    write_certificate(dir, 2100);
    std::fs::write(dir.join("key.pem"), key).unwrap();
    off(&trusted).expect("half renewed");
    let refused = off(&trusted[..1]).unwrap_err().to_string();
    assert!(refused.contains("UnknownIssuer"), "{refused}");
}
