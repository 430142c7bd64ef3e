//! The simulated power stage against ngspice's committed values (tests/circuit-oracle).

use std::path::Path;

use ihd_tests::circuit_oracle::{CASES, Values, folder};

/// Largest difference from ngspice, as a share.
const TOLERANCE: f64 = 2e-3;

/// The same where the link is small beside what a period draws from it.
const SMALL_LINK_TOLERANCE: f64 = 5e-3;

/// Capacitance below which that counts, in farad.
const SMALL_LINK_F: f64 = 2e-6;

/// The same for a few percent of the crest that a link holds at the crossing: its time constant is what is left to see.
const SMALL_TOLERANCE: f64 = 0.02;

/// Bus voltage below which the larger tolerance counts, in volt.
const SMALL_BUS_V: f64 = 100.0;

#[test]
fn every_case_is_ngspices() {
    let text = std::fs::read_to_string(folder().join("values.csv")).expect("committed");
    let mut rows = text.lines();
    assert_eq!(
        rows.next(),
        Some(format!("case,{}", Values::NAMES.join(",")).as_str())
    );
    let mut wrong = Vec::new();
    for case in CASES {
        let row = rows.next().unwrap_or_default();
        let (name, numbers) = row.rsplit_once("\",").expect("name and numbers");
        assert_eq!(name, format!("\"{}", case.name));
        let small_link = (1e-9..SMALL_LINK_F).contains(&case.supply.link_capacitance_f);
        let tolerance = if small_link {
            SMALL_LINK_TOLERANCE
        } else {
            TOLERANCE
        };
        let (ours, _) = case.simulate(usize::MAX);
        let spice = numbers
            .split(',')
            .map(|x| x.parse::<f64>().expect("number"));
        for ((name, ours), spice) in Values::NAMES.into_iter().zip(ours.numbers()).zip(spice) {
            let percent = 100.0 * (ours - spice) / spice;
            println!("{}: {name} {spice:.4e} ({percent:+.2} %)", case.name);
            // After a stop nothing flows in the second half-cycle.
            let limit = match name {
                "bus_crossing_v" if spice < SMALL_BUS_V => SMALL_TOLERANCE * spice.max(5.0),
                _ => tolerance * spice + 1e-3,
            };
            if (ours - spice).abs() > limit {
                wrong.push(format!("{}: {name} is {ours}, ngspice {spice}", case.name));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// docs/power-stage.cir is the netlist with the schematic's values: one that changes there shows here. `UPDATE_DOCS=1` rewrites it.
#[test]
fn the_documents_netlist_has_the_schematics_parts() {
    let netlist = CASES[2].netlist(None);
    for part in [
        "C2 dc 0 4.700000e-6",
        "Lline e1 t 8.000000e-4",
        "C1 t b 4.700000e-7",
        "Rbleed dc 0 85406",
        "Cr x 0 1080n",
        "Clow sw 0 7.5n",
    ] {
        assert!(netlist.contains(part), "{part}\n{netlist}");
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/power-stage.cir");
    if std::env::var_os("UPDATE_DOCS").is_some() {
        std::fs::write(&path, &netlist).expect("docs can be written");
    }
    let committed = std::fs::read_to_string(&path).expect("docs/power-stage.cir");
    assert_eq!(
        committed, netlist,
        "UPDATE_DOCS=1 cargo test -p ihd-tests circuit_oracle"
    );
}
