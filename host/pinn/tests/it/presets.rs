//! Presets by name: in code, as files in the program, in a folder, and over each other in TOML.

use std::path::Path;

use ihd_pinn::{Optimiser, PinnConfig, PinnError, Preset, PresetLibrary, SlowEmbedding, ViMlp};

/// `paper-repaired` with one change to its VI-MLP.
fn repaired(change: impl FnOnce(&mut ViMlp)) -> PinnConfig {
    let mut config = Preset::PaperRepaired.config();
    change(config.vi_mlp.as_mut().expect("has one"));
    config
}

/// Settings of each ablation, written in Rust: their digits are in docs/accuracy.md.
fn ablations() -> [(&'static str, PinnConfig); 9] {
    let hybrid = PinnConfig::default;
    [
        (
            "repaired-unscaled",
            PinnConfig {
                r_scale_ohm: 1.0,
                l_scale_h: 1.0,
                ..Preset::PaperRepaired.config()
            },
        ),
        ("repaired-fast-only", repaired(|vi| vi.slow = None)),
        (
            "repaired-eq3",
            PinnConfig {
                embedding: SlowEmbedding::Fourier { first: 1, count: 1 },
                ..Preset::PaperRepaired.config()
            },
        ),
        (
            "repaired-minibatch",
            repaired(|vi| vi.minibatch = Some(5000)),
        ),
        ("repaired-decay", repaired(|vi| vi.last_rate = 1.0 / 30.0)),
        (
            "hybrid-paper-net",
            PinnConfig {
                hidden_layers: vec![16; 4],
                correction: false,
                ..hybrid()
            },
        ),
        (
            "hybrid-adam",
            PinnConfig {
                optimiser: Optimiser::Adam,
                max_iterations: 10_000,
                correction: false,
                ..hybrid()
            },
        ),
        (
            "hybrid-no-prior",
            PinnConfig {
                weight_width: 0.0,
                correction: false,
                ..hybrid()
            },
        ),
        (
            "at-once",
            PinnConfig {
                at_once: true,
                ..hybrid()
            },
        ),
    ]
}

#[test]
fn the_ablations_files_are_what_the_document_measured() {
    let library = PresetLibrary::default();
    for (name, expected) in ablations() {
        let found = library.get(name).expect("in the program");
        assert_eq!(found.config, expected, "{name}");
        assert!(!found.description.is_empty(), "{name}");
        let over = PinnConfig::from_toml(&format!("preset = \"{name}\"\nseed = 4")).expect("sound");
        assert_eq!(
            over,
            PinnConfig {
                seed: 4,
                ..expected
            }
        );
    }
    let all = Preset::ALL.len() + ablations().len();
    assert_eq!(library.names().len(), all);
    assert!(library.names().iter().all(|name| library.get(name).is_ok()));
}

#[test]
fn the_document_lists_every_preset() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/identification.md");
    let document = std::fs::read_to_string(path).expect("in the repository");
    for name in PresetLibrary::default().names() {
        assert!(document.contains(&format!("| `{name}` |")), "{name}");
    }
}

#[test]
fn an_unknown_name_gets_the_names_that_there_are() {
    let error = PresetLibrary::default().get("nope").expect_err("no such");
    for name in ["hybrid", "paper-literal", "repaired-eq3"] {
        assert!(error.to_string().contains(name), "{error}");
    }
    assert_eq!(PinnConfig::from_toml("preset = \"nope\""), Err(error));
    let error = PinnConfig::from_toml("backend = \"tpu\"").expect_err("no such");
    assert!(error.to_string().contains("fused, ndarray"), "{error}");
    let error = PinnConfig::from_toml("optimiser = \"sgd\"").expect_err("no such");
    assert!(
        error.to_string().contains("levenberg-marquardt, adam"),
        "{error}"
    );
}

#[test]
fn a_folders_files_are_presets_named_as_they_are() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        std::fs::write(folder.path().join(name), text).expect("writable");
    };
    let refused = || match PresetLibrary::with_folder(folder.path()) {
        Err(PinnError::File { detail }) => detail,
        other => panic!("{other:?}"),
    };
    assert!(refused().contains("no *.toml"));
    write("wide.toml", "preset = \"hybrid-paper-net\"\nseed = 7\n");
    write("notes.txt", "no preset");
    let library = PresetLibrary::with_folder(folder.path()).expect("sound");
    assert_eq!(library.folder_names().collect::<Vec<_>>(), ["wide"]);
    let wide = library.get("wide").expect("in the folder").config;
    assert_eq!((wide.hidden_layers, wide.seed), (vec![16; 4], 7));
    assert!(library.get("hybrid").is_ok());
    write("hybrid.toml", "seed = 1\n");
    assert!(refused().contains("rename it"));
    std::fs::remove_file(folder.path().join("hybrid.toml")).expect("was written");
    write("odd.toml", "sed = 1\n");
    assert!(refused().contains("odd.toml"), "{}", refused());
    std::fs::remove_file(folder.path().join("odd.toml")).expect("was written");
    write("a b.toml", "seed = 1\n");
    assert!(refused().contains("letters"));
}

#[test]
fn toml_files_lie_over_their_preset() {
    let text = "preset = \"paper-repaired\"\nseed = 9\n[vi_mlp]\nn_sw = 5\n";
    let config = PinnConfig::from_toml(text).expect("sound");
    let mut expected = repaired(|vi| vi.n_sw = 5);
    expected.seed = 9;
    assert_eq!(config, expected);
    assert_eq!(
        PinnConfig::from_toml("").expect("empty"),
        PinnConfig::default()
    );
    for preset in Preset::ALL {
        let named = PinnConfig::from_toml(&format!("preset = \"{preset}\"")).expect("known");
        assert_eq!(named, preset.config());
    }
    for wrong in [
        "preset = \"best\"",
        "preset = 3",
        "description = 3",
        "sed = 1",
        "[vi_mlp]\nn_sww = 1",
        "seed = -",
        "w_f = -1.0",
    ] {
        assert!(PinnConfig::from_toml(wrong).is_err(), "{wrong}");
    }
}
