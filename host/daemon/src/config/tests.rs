use super::*;

const ISSUE: &str = r#"
    store = "ihd-store"
    listen = "127.0.0.1:8731"
    [[device]]
    name = "bench"
    address = "tcp:127.0.0.1:4711"
"#;

fn refused(text: &str) -> String {
    DaemonConfig::parse(text, "ihd.toml")
        .unwrap_err()
        .to_string()
}

#[test]
fn the_example_of_the_issue_is_read() {
    let config = DaemonConfig::parse(ISSUE, "ihd.toml").unwrap();
    assert_eq!(config.store, Path::new("ihd-store"));
    assert_eq!(config.listen.to_string(), "127.0.0.1:8731");
    assert_eq!(config.devices.len(), 1);
    assert_eq!(config.devices[0].name, "bench");
    assert_eq!(config.devices[0].address.to_string(), "tcp:127.0.0.1:4711");
    assert!(!config.discovers_usb());
}

#[test]
fn nothing_at_all_is_a_configuration_that_looks_for_boards() {
    let config = DaemonConfig::parse("", "ihd.toml").unwrap();
    assert!(config.discovers_usb());
    assert_eq!(config.keep.max_bytes, 2_000_000_000);
}

#[test]
fn every_key_is_read() {
    let config = DaemonConfig::parse(
        r#"
        store = "/var/lib/ihd"
        listen = "[::1]:9000"
        allowed_hosts = ["hob.lan"]
        token_file = "tokens"
        discover_usb = true
        tls = { certificate = "c.pem", key = "k.pem" }
        keep = { windows = "one-in-10", max_age_days = 30, max_bytes = 5000000 }
        learning = { threads = 2, queue = 8 }
        network = { preset = "hybrid", seed = 7 }
        [[device]]
        name = "a"
        address = "usb:1234"
        [[device]]
        name = "b"
        address = "sim"
        sim = { pot = "aluminium", warming = true }
        "#,
        "ihd.toml",
    )
    .unwrap();
    assert_eq!(
        config.store_settings().keep,
        ihd_store::SamplePolicy::OneIn(10)
    );
    assert_eq!(config.learning.threads, 2);
    assert_eq!(config.network().unwrap().seed, 7);
    assert!(config.discovers_usb());
    assert_eq!(config.devices[1].address.sim.len(), 2);
}

#[test]
fn what_is_wrong_is_named() {
    let device = |name: &str, address: &str| {
        format!("[[device]]\nname = \"{name}\"\naddress = \"{address}\"\n")
    };
    let twice = device("a", "sim") + &device("a", "usb");
    let place = device("a", "tcp:h:1") + &device("b", "tcp:h:1");
    for (text, words) in [
        ("stor = \"x\"", &["stor", "store"][..]),
        ("[keep]\nwindow = 1", &["window"]),
        (
            "[keep]\nwindows = \"some\"",
            &["windows", "some", "telling"],
        ),
        ("[keep]\nwindows = \"one-in-0\"", &["one-in-0"]),
        ("[keep]\nmax_bytes = 1", &["keep.max_bytes = 1"]),
        (
            "allowed_hosts = [\"hob.lan:8731\"]",
            &["allowed_hosts", "hob.lan:8731"],
        ),
        (
            "allowed_hosts = [\"https://hob.lan\"]",
            &["allowed_hosts", "https://hob.lan"],
        ),
        ("[learning]\nthreads = 0", &["learning.threads = 0"]),
        ("[network]\nsead = 1", &["[network]", "sead"]),
        ("listen = \"here\"", &["listen"]),
        ("[tls]\nkey = \"k\"", &["tls.certificate"]),
        (&device("A", "sim"), &["\"A\"", "a-z"]),
        (&device("", "sim"), &["name = \"\""]),
        (&device("a", "bus:1"), &["bus:1", "tcp:HOST:PORT"]),
        (&twice, &["\"a\" stands twice"]),
        (&place, &["tcp:h:1", "twice"]),
        (
            "[[device]]\nname = \"a\"\naddress = \"usb\"\nsim = {}",
            &["sim", "usb"],
        ),
        ("[[device]]\nname = \"a\"", &["address"]),
    ] {
        let why = refused(text);
        for word in words {
            assert!(why.contains(word), "{text}: {why}");
        }
        assert!(why.contains("ihd.toml"), "{why}");
    }
}
