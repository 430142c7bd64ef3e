//! docs/daemon.md says what is: its configuration is read, its commands are there.

use ihd_daemon::config::DaemonConfig;

use super::processes::{ihd, outcome};

const DOCUMENT: &str = include_str!("../../../../../docs/daemon.md");

fn example() -> &'static str {
    let (_, rest) = DOCUMENT.split_once("```toml\n").expect("an example");
    rest.split_once("```").expect("its end").0
}

#[test]
fn the_example_is_read_as_it_is_and_with_everything_that_is_commented_out() {
    let config = DaemonConfig::parse(example(), "docs/daemon.md").unwrap();
    assert_eq!(config.devices.len(), 2);
    let all: String = example()
        .lines()
        .map(|line| {
            line.strip_prefix("# ")
                .filter(|l| l.contains('=') || l.starts_with('['))
                .unwrap_or(line)
        })
        .map(|line| format!("{line}\n"))
        .collect();
    let config = DaemonConfig::parse(&all, "docs/daemon.md").unwrap();
    assert!(config.tls.is_some() && config.token_file.is_some(), "{all}");
    assert!(
        config.keep.max_age_days.is_some() && config.network.is_some(),
        "{all}"
    );
    ihd::cli::opener::opener(&mut config.clone())
        .map(drop)
        .unwrap();
}

#[test]
fn every_key_that_there_is_stands_in_the_example() {
    // The keys are those that the parser names when it is given none of them.
    for (text, table) in [
        ("x = 1", ""),
        ("[keep]\nx = 1", "[keep]"),
        ("[learning]\nx = 1", "[learning]"),
        ("[tls]\nx = 1", "[tls]"),
        ("[[device]]\nx = 1", "[[device]]"),
    ] {
        let error = DaemonConfig::parse(text, "t").unwrap_err().to_string();
        let (_, keys) = error.split_once("expected").expect("what there is");
        let keys: Vec<&str> = keys.split('`').skip(1).step_by(2).collect();
        assert!(keys.len() >= 2, "{error}");
        for key in keys {
            let stands = [format!("{key} ="), format!("[{key}]"), format!("[[{key}]]")];
            assert!(
                stands.iter().any(|s| example().contains(s)),
                "{table} {key} is not in the example"
            );
        }
    }
}

#[test]
fn every_command_of_the_help_is_in_the_document() {
    let (code, help, _) = outcome(ihd().args(["device", "--help"]).output().unwrap());
    assert_eq!(code, 0);
    let commands = help.split("Commands:").nth(1).expect("commands");
    for line in commands
        .lines()
        .skip(1)
        .take_while(|l| !l.trim().is_empty())
    {
        let Some(name) = line.strip_prefix("  ").filter(|l| !l.starts_with(' ')) else {
            continue;
        };
        let name = name.split_whitespace().next().unwrap();
        let named =
            DOCUMENT.contains(&format!("`DEV {name}")) || DOCUMENT.contains(&format!("`{name}`"));
        assert!(named || name == "help", "{name} is not in docs/daemon.md");
    }
}
