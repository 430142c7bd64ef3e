//! Exit code and message of wrong arguments.

use assert_cmd::Command;

#[test]
fn wrong_usage_is_2_and_names_what_is_wrong() {
    let table = [
        ("estimators --seeds 0", "--seeds"),
        ("hostile --seeds 0", "--seeds"),
        ("hostile --only no-such-capture", "no capture"),
        ("map --seeds 0", "--seeds"),
        ("map --pot ferritic-18+left", "+lift-10mm"),
        ("map --power 9999", "2500"),
        ("map --load behavioural", "lift-10mm"),
        ("map --pot ferritic-18+lift-900mm", "lift_m"),
        ("map --load field --perturb rings", "reduced"),
        ("map --load behavioural --perturb tail", "reduced"),
        ("paper --seeds 0", "--seeds"),
        ("paper --epochs 0", "--epochs"),
        ("", "Usage"),
        ("nonsense", "nonsense"),
    ];
    for (args, word) in table {
        let mut command =
            Command::cargo_bin("ihd-study").expect("the binary is built with its tests");
        let output = command
            .args(args.split_whitespace())
            .output()
            .expect("it runs");
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args}: {stderr}");
        assert!(output.stdout.is_empty(), "{args}");
        assert!(stderr.contains(word), "{args}: {word} not in {stderr}");
    }
}
