//! The client against the server: every route, every error, TLS.

use std::time::Duration;

use ihd_api::ApiClient;
use ihd_api::access::{Role, tokens::Tokens};
use ihd_api::client::ClientError;
use ihd_api::tls::Certificate;
use ihd_daemon::model::{Command, CommandError, Quantity, RecordSettings, Trigger};

use crate::backend::{NAME, Running};

fn client(server: &Running, holder: &str) -> ApiClient {
    ApiClient::new(&server.url, holder, None, None).unwrap()
}

#[test]
fn every_route_has_a_method_that_works() {
    let server = Running::start();
    let ada = client(&server, "Ada");
    assert!(ada.health(Duration::from_millis(500)).unwrap().store);
    let devices = ada.devices().unwrap();
    assert_eq!(devices[0].name, NAME);
    assert_eq!(ada.device(NAME).unwrap(), devices[0]);
    assert_eq!(ada.lookups(NAME).unwrap()[0].blob, [0, 255]);
    assert_eq!(ada.results(NAME, 7, Some(-3)).unwrap(), []);
    assert_eq!(ada.take_lease(NAME, false).unwrap().holder, "Ada");
    let commands = [
        Command::Power { power_w: 1200 },
        Command::Off,
        Command::ClearFault,
        Command::LookupPush {
            blob: (0..=255).cycle().take(560).collect(),
        },
        Command::LookupRollback { version: None },
        Command::LookupRollback { version: Some(3) },
        Command::LookupReset,
        Command::Sweep {
            powers_w: vec![700, 1000],
        },
        Command::RecordStart(RecordSettings::default()),
        Command::RecordStart(RecordSettings {
            trigger: Trigger::Level {
                quantity: Quantity::Inductance,
                level: 28.5,
                rising: false,
            },
            pre_trigger_s: 2.5,
            duration_s: Some(30.0),
        }),
        Command::RecordStop,
    ];
    for command in &commands {
        assert_eq!(ada.command(NAME, command).unwrap().text, "done");
    }
    ada.release_lease(NAME).unwrap();
    assert!(ada.backup("monday").unwrap().path.ends_with("monday"));
    let asked = server.fake.asked.lock().unwrap();
    let got: Vec<&Command> = asked.commands.iter().map(|(_, c)| c).collect();
    assert_eq!(got, commands.iter().collect::<Vec<_>>());
    assert!(asked.commands.iter().all(|(holder, _)| holder == "Ada"));
    assert_eq!(asked.results, [(7, Some(-3))]);
    assert_eq!(asked.lease, None);
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
    let client = ApiClient::new(&format!("http://{address}"), "me", None, None).unwrap();
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
    let server = Running::with(|settings, dir| {
        settings.token_file = Some(dir.join("tokens"));
        settings.tls = Some(Certificate::Generated {
            folder: dir.join("tls"),
        });
    });
    assert!(server.url.starts_with("https://"), "{}", server.url);
    let tokens = Tokens::read(&server.dir.path().join("tokens")).unwrap();
    let token = |role| tokens.at_least(role).map(str::to_owned);
    let ca = server.certificate.as_deref();
    let ada = ApiClient::new(&server.url, "Ada", token(Role::Operate), ca).unwrap();
    assert_eq!(ada.devices().unwrap().len(), 1);
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
    let stranger = ApiClient::new(&server.url, "Eve", token(Role::Read), None).unwrap();
    let refused = stranger.devices().unwrap_err();
    assert!(
        matches!(refused, ClientError::Unreachable { .. }),
        "{refused}"
    );
    // Plain HTTP to a TLS port gets no response.
    let plain = server.url.replace("https", "http");
    let plain = ApiClient::new(&plain, "Eve", None, None).unwrap();
    assert!(plain.devices().is_err());
}
