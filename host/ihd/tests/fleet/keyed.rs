//! The four commands of docs/fleet.md: the real edge and the real worker, each with the key that `ihd-fleet init server-config` made.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::time::{Duration, Instant};

use ihd_fakes::free_address;
use ihd_shared::lookup::RlLookup;
use serde_json::Value;

use crate::process::{Process, ihd};
use crate::server::{self, Server};
use crate::site::{PATIENCE, heat, ihd_fleet};

/// Server with keys in its folder.
struct Keyed {
    server: Server,
}

impl Keyed {
    fn start() -> Self {
        let server = Server::configured(|place| {
            let names = vec![place.address.to_string()];
            let made = rcgen::generate_simple_self_signed(names).unwrap();
            let file = |name: &str| place.folder.join(name);
            fs::write(file("certificate.pem"), made.cert.pem()).unwrap();
            fs::write(file("key.pem"), made.signing_key.serialize_pem()).unwrap();
            let mut command = ihd_fleet(&place.folder);
            command
                .args(["init", "server-config", "--site", "lab", "--keys", "keys"])
                .args(["--edge", "lab-1=bench", "--edge", "lab-2=other"])
                .args(["--fleet-page", "lab-1", "--disk-bytes", "4000000000"])
                .args(["--listen", &format!("{}:-1", place.address)])
                .arg("--tls")
                .arg(&place.folder)
                .arg("--store")
                .arg(file("store"));
            let out = command.output().unwrap();
            assert!(out.status.success(), "{out:?}");
            String::from_utf8(out.stdout).unwrap()
        });
        Self { server }
    }

    fn url(&self) -> String {
        format!("tls://{}", self.server.address())
    }

    fn file(&self, name: &str) -> PathBuf {
        self.server.folder().join(name)
    }

    fn key(&self, name: &str) -> PathBuf {
        self.file(&format!("keys/lab-{name}.nk"))
    }

    /// `ihd-fleet …` with a key: what it prints, and its exit code.
    fn fleet(&self, key: &str, arguments: &[&str]) -> (String, i32) {
        let mut command = ihd_fleet(self.server.folder());
        command.args(["--url", &self.url(), "--ca"]);
        command.arg(self.file("certificate.pem")).arg("--nkey-file");
        let out = command.arg(self.key(key)).args(arguments).output().unwrap();
        let text = [&out.stdout[..], &out.stderr].concat();
        let text = String::from_utf8_lossy(&text).into_owned();
        (text, out.status.code().unwrap_or(-1))
    }

    /// `ihd-fleet status --json` of the operator.
    fn status(&self) -> Value {
        let (text, code) = self.fleet("operator", &["status", "--json"]);
        assert_eq!(code, 0, "{text}");
        serde_json::from_str(&text).unwrap()
    }

    fn worker(&self) -> Process {
        let mut command = ihd_fleet(self.server.folder());
        command.args(["worker", "--threads", "1", "--name", "worker-1"]);
        command.args(["--url", &self.url(), "--ca"]);
        command.arg(self.file("certificate.pem")).arg("--nkey-file");
        command.arg(self.key("worker-worker-1"));
        started(&mut command, &self.file("worker.log"))
    }

    /// Starts a daemon with simulated hobs, in the server's folder.
    fn edge(&self, hobs: &[&str]) -> Process {
        let listen = free_address().to_string();
        let mut text = format!(
            "store = \"ihd-store\"\nlisten = {listen:?}\ndiscover_usb = false\n\
             [fleet]\nurl = {:?}\nedge = \"lab-1\"\nnkey_file = {:?}\nca = \"certificate.pem\"\n",
            self.url(),
            self.key("edge-lab-1"),
        );
        for hob in hobs {
            text += &format!("[[device]]\nname = {hob:?}\naddress = \"sim\"\n");
        }
        fs::write(self.file("ihd.toml"), text).unwrap();
        let mut command = ihd(self.server.folder());
        command
            .args(["trainer", "--daemon"])
            .env("RUST_LOG", "info");
        started(&mut command, &self.file("edge.log"))
    }

    fn logs(&self) -> String {
        let read = |name: &str| fs::read_to_string(self.file(name)).unwrap_or_default();
        format!(
            "{}\n{}\n{}\n{}",
            self.status(),
            read("edge.log"),
            read("worker.log"),
            self.server.log()
        )
    }

    fn until(&self, what: &str, mut holds: impl FnMut() -> bool) {
        let began = Instant::now();
        while !holds() {
            assert!(began.elapsed() < PATIENCE, "{what}: {}", self.logs());
            std::thread::sleep(Duration::from_millis(200));
        }
    }
}

fn started(command: &mut std::process::Command, log: &Path) -> Process {
    let log = fs::File::create(log).unwrap();
    Process::spawn(command.stdout(Stdio::null()).stderr(log)).unwrap()
}

#[test]
fn the_whole_fleet_works_with_keys_and_none_does_more_than_its_own() {
    let keyed = Keyed::start();
    let small = [
        "--windows-bytes",
        "100000000",
        "--results-bytes",
        "100000000",
    ];
    let init = [
        &[
            "init",
            "--edge",
            "lab-1=bench",
            "--captures-bytes",
            "100000000",
        ],
        &small[..],
    ]
    .concat();
    for key in ["edge-lab-1", "worker-worker-1"] {
        let (text, code) = keyed.fleet(key, &init);
        assert_ne!(code, 0, "{key}: {text}");
    }
    let (text, code) = keyed.fleet("operator", &init);
    assert_eq!(code, 0, "{text}");

    let (_edge, _worker) = (keyed.edge(&["bench"]), keyed.worker());
    keyed.until("edge and worker are seen, and the fleet is trusted", || {
        let status = keyed.status();
        let edge = &status["edges"][0];
        edge["name"] == "lab-1"
            && edge["trusts_fleet"] == true
            && status["workers"][0]["name"] == "worker-1"
    });
    heat(keyed.server.folder(), "bench", "1500");
    // The number of windows depends on the machine; each sent window has a result.
    keyed.until("a result for each window", || {
        let status = keyed.status();
        let windows = status["windows"].as_u64();
        windows >= Some(1) && status["results"].as_u64() == windows && status["backlog"] == 0
    });
    println!("{}", keyed.status());
    // Revision of the hob's last lookup, and `true` if it is in use.
    let last_lookup = || {
        let (text, _) = keyed.fleet("operator", &["lookup", "ls", "--json"]);
        let last = serde_json::from_str::<Value>(&text).ok()?[0].clone();
        Some((last["revision"].as_u64()?, last["lookup"]["in_use"] == true))
    };
    let is_in_use =
        |after| last_lookup().is_some_and(|(revision, in_use)| in_use && Some(revision) > after);
    keyed.until("the lookup of the hob", || {
        let is_there = is_in_use(None);
        if !is_there {
            heat(keyed.server.folder(), "bench", "1500");
        }
        is_there
    });
    let (first, _) = last_lookup().expect("a lookup");
    // An operator wants an older one used: the edge pushes it, and reports it in use.
    let (text, code) = keyed.fleet("operator", &["lookup", "push", "bench", &first.to_string()]);
    assert_eq!(code, 0, "{text}");
    keyed.until("the requested lookup in use", || is_in_use(Some(first + 1)));
    // One that contradicts what the hob has measured is refused once, with the reason.
    let of_hob = || {
        let (text, _) = keyed.fleet("operator", &["lookup", "ls", "bench", "--json"]);
        serde_json::from_str::<Vec<Value>>(&text).unwrap_or_default()
    };
    let blob = of_hob().pop().expect("a lookup")["lookup"]["blob"].clone();
    let digits = blob.as_str().expect("digits").as_bytes().chunks(2);
    let bytes: Vec<u8> = digits
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap())
        .collect();
    let mut lie = RlLookup::from_bytes(&bytes).unwrap();
    lie.r.iter_mut().flatten().for_each(|r| *r += *r / 7);
    let path = keyed.file("lie.bin");
    fs::write(&path, lie.to_bytes()).unwrap();
    let (text, code) = keyed.fleet(
        "operator",
        &["lookup", "push", "bench", &path.display().to_string()],
    );
    assert_eq!(code, 0, "{text}");
    keyed.until(
        "the contradicting lookup refused, and the other still in use",
        || {
            let refused = of_hob()
                .iter()
                .any(|entry| entry["lookup"]["refused"].is_string());
            refused && is_in_use(Some(first + 2))
        },
    );
    assert_eq!(
        keyed.status()["edges"][0]["trusts_fleet"],
        true,
        "{}",
        keyed.logs()
    );

    // No request of an edge is denied: neither its name nor the dead letters of its hobs.
    let log = fs::read_to_string(keyed.file("edge.log")).unwrap();
    assert!(log.contains("the edge's name is this store's"), "{log}");
    assert!(!log.contains("WARN fleet: "), "{log}");

    // The fleet's page: keys that may read it, and keys that may not.
    let (text, code) = keyed.fleet("edge-lab-1", &["status", "--json"]);
    assert_eq!(code, 0, "{text}");
    for key in ["edge-lab-2", "worker-worker-1"] {
        let (text, code) = keyed.fleet(key, &["status", "--json"]);
        assert_ne!(code, 0, "{key}: {text}");
    }
    // A key that does not exist.
    let (_, code) = keyed.fleet("nobody", &["status"]);
    assert_ne!(code, 0);
}

/// "aaa" is in ihd.toml, not in nats.conf; "bench" has its rights and is not in `init --edge` at first.
#[test]
fn a_hob_without_rights_and_one_that_init_forgot_are_alarms_and_stop_no_other() {
    let keyed = Keyed::start();
    let limits = [
        "--windows-bytes",
        "100000000",
        "--results-bytes",
        "100000000",
    ];
    let init = |edge: &str| {
        let arguments = [
            &["init", "--captures-bytes", "100000000", "--edge", edge],
            &limits[..],
        ];
        let (text, code) = keyed.fleet("operator", &arguments.concat());
        assert_eq!(code, 0, "{text}");
    };
    init("lab-1=elsewhere");
    let (_edge, _worker) = (keyed.edge(&["aaa", "bench"]), keyed.worker());
    let heat = |hob| heat(keyed.server.folder(), hob, "1500");
    keyed.until("an alarm of each", || {
        let (text, code) = keyed.fleet("operator", &["status", "--check"]);
        let names = |hob: &str| text.contains(&format!("refuses hob {hob} ("));
        code == 7 && names("aaa") && text.contains("init --edge lab-1=aaa,bench")
    });
    heat("aaa");
    heat("bench");
    assert_eq!(keyed.status()["windows"], 0, "{}", keyed.logs());
    init("lab-1=bench");
    keyed.until("windows of the one with rights, and its card", || {
        let status = keyed.status();
        let hobs = status["devices"].as_array().cloned().unwrap_or_default();
        status["results"].as_u64() >= Some(1) && hobs.iter().any(|hob| hob["name"] == "bench")
    });
    let log = fs::read_to_string(keyed.file("edge.log")).unwrap();
    let lines = log.lines().filter(|line| line.contains("WARN fleet: "));
    assert!(lines.count() < 20, "{log}");
}

/// The first page of docs/fleet.md: one command, and the lines that it prints.
#[test]
fn up_prints_what_edge_and_worker_need_and_an_open_key_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let read = |name: &str| fs::read_to_string(file(name)).unwrap_or_default();
    let until = |what: &str, holds: &dyn Fn() -> bool| {
        let began = Instant::now();
        while !holds() {
            let logs = ["up", "edge.log", "worker.log", "ihd-fleet/nats.log"].map(read);
            assert!(began.elapsed() < PATIENCE, "{what}: {logs:#?}");
            std::thread::sleep(Duration::from_millis(200));
        }
    };
    let listen = free_address().to_string();
    let up = || {
        let out = fs::File::create(file("up")).unwrap();
        let mut command = ihd_fleet(folder.path());
        command
            .args(["init", "up", "--edge", "lab-1=bench", "--listen", &listen])
            .env(server::PROGRAM, server::program());
        let command = command.stdout(out.try_clone().unwrap()).stderr(out);
        Process::spawn(command).unwrap()
    };
    let printed = || read("up").contains("ihd-fleet worker ");
    let running = up();
    until("the lines for edge and worker", &printed);
    let text = read("up");
    let fleet = text.split("[fleet]\n").nth(1).unwrap();
    let fleet = fleet.split("\n\n").next().unwrap();
    let page = free_address().to_string();
    let config = format!(
        "listen = {page:?}\ndiscover_usb = false\n[fleet]\n{fleet}\n[[device]]\nname = \"bench\"\naddress = \"sim\"\n"
    );
    fs::write(file("ihd.toml"), config).unwrap();
    let worker = text
        .lines()
        .find(|line| line.starts_with("ihd-fleet worker "))
        .unwrap();
    let worker = || {
        let mut command = ihd_fleet(folder.path());
        command.args(worker.split_whitespace().skip(1));
        command
    };
    let mut edge = ihd(folder.path());
    edge.args(["trainer", "--daemon"]).env("RUST_LOG", "info");
    let _edge = started(&mut edge, &file("edge.log"));
    let working = started(&mut worker(), &file("worker.log"));
    let status = || -> Option<Value> {
        // Whom to ask stands in ihd.toml.
        let out = ihd_fleet(folder.path())
            .args(["status", "--json"])
            .output()
            .unwrap();
        serde_json::from_slice(&out.stdout).ok()
    };
    until("a result", &|| {
        heat(folder.path(), "bench", "1500");
        status().is_some_and(|s| s["results"].as_u64() >= Some(1))
    });

    // A restart in the same folder continues with its data.
    drop(running);
    let _running = up();
    until("the lines, again", &printed);
    until("what it kept", &|| {
        status().is_some_and(|s| s["results"].as_u64() >= Some(1))
    });

    drop(working);
    let key = file("ihd-fleet/keys/fleet-worker-worker-1.nk");
    let open = std::os::unix::fs::PermissionsExt::from_mode(0o644);
    fs::set_permissions(&key, open).unwrap();
    let out = worker().output().unwrap();
    let text = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(
        !out.status.success() && text.contains("chmod 600"),
        "{text}"
    );
}
