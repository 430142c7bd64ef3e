//! Field model against finite elements of scikit-fem: R and L of tests/field-oracle/field.csv, limits on both sides.

#[path = "../../../tests/it/document.rs"]
mod document;

use std::collections::BTreeMap;
use std::fmt::Write as _;

use ihd_field::model::FieldSettings;
use ihd_field::{FieldModel, Material, harmonic};

const FINITE_ELEMENTS: &str = include_str!("../../../tests/field-oracle/field.csv");

/// Limits of R and L in percent: for linear metals, and with saturation.
const LINEAR_PCT: (f64, f64) = (2.0, 1.0);
const SATURATING_PCT: (f64, f64) = (1.0, 1.0);

/// Thickness of the ferritic foil below an aluminium base, in metre.
const FOIL_M: f64 = 0.5e-3;

/// Diameters of the short form, in millimetre.
const SHORT_MM: [f64; 3] = [80.0, 120.0, 210.0];

/// Line of the file.
#[derive(Clone, Debug)]
struct Row {
    metal: &'static str,
    diameter_mm: f64,
    thickness_mm: f64,
    wall_mm: f64,
    lift_mm: f64,
    shield_mm: f64,
    f_khz: f64,
    i_a: f64,
    r_ohm: f64,
    l_uh: f64,
}

impl Row {
    fn all() -> Vec<Self> {
        let of_line = |line: &'static str| {
            let (metal, numbers) = line.split_once(',').unwrap();
            let numbers: Vec<f64> = numbers.split(',').map(|n| n.parse().unwrap()).collect();
            let [
                diameter_mm,
                thickness_mm,
                wall_mm,
                lift_mm,
                shield_mm,
                f_khz,
                i_a,
                r_ohm,
                l_uh,
            ] = numbers[..]
            else {
                panic!("nine numbers: {line}");
            };
            Self {
                metal,
                diameter_mm,
                thickness_mm,
                wall_mm,
                lift_mm,
                shield_mm,
                f_khz,
                i_a,
                r_ohm,
                l_uh,
            }
        };
        FINITE_ELEMENTS.lines().skip(2).map(of_line).collect()
    }

    /// Arrangement without frequency and current.
    fn arrangement(&self) -> String {
        let mut name = self.metal.to_owned();
        if self.metal == "none" {
            let _ = write!(name, ", shield {} mm", self.shield_mm);
            return name;
        }
        let _ = write!(name, " {} mm", self.diameter_mm);
        for (what, value, usual) in [
            ("base", self.thickness_mm, 5.0),
            ("wall", self.wall_mm, 0.0),
            ("lift", self.lift_mm, 0.0),
        ] {
            if value != usual {
                let _ = write!(name, ", {what} {value} mm");
            }
        }
        name
    }

    fn model(&self) -> FieldModel {
        let mut s = FieldSettings::paper();
        let g = &mut s.geometry;
        g.turns_calibration = 1.0;
        g.load_radius_m = self.diameter_mm / 2e3;
        g.load_thickness_m = self.thickness_mm / 1e3;
        g.wall_height_m = self.wall_mm / 1e3;
        g.load_gap_m += self.lift_mm / 1e3;
        g.shield_thickness_m = self.shield_mm / 1e3;
        s.material = match self.metal {
            "none" => return FieldModel::bare_coil(&s).unwrap(),
            "aluminium" => Material::ALUMINIUM,
            "copper" => Material::Linear {
                mu_r: 1.0,
                sigma_s_per_m: 5.8e7,
            },
            "stainless-304" => Material::STAINLESS_304,
            // At no current the laws of ferromagnetic metals are linear.
            "ferritic" | "ferritic-saturating" => Material::PAPER,
            "cast-iron" => Material::GREY_CAST_IRON,
            "clad" | "clad-saturating" => {
                s.geometry.foil_thickness_m = FOIL_M;
                Material::ALUMINIUM
            }
            other => panic!("metal {other}"),
        };
        FieldModel::new(&s).unwrap()
    }

    /// Limits of R and L in percent.
    fn limits_pct(&self) -> (f64, f64) {
        if self.i_a > 0.0 {
            SATURATING_PCT
        } else {
            LINEAR_PCT
        }
    }
}

/// Differences of the model in percent: (R, L); R is `None` where both have none.
fn differences(rows: &[Row]) -> Vec<(Option<f64>, f64)> {
    let mut models: BTreeMap<String, FieldModel> = BTreeMap::new();
    let difference = |row: &Row| {
        let known = models.entry(row.arrangement());
        let z = harmonic::impedance(
            known.or_insert_with(|| row.model()),
            1e3 * row.f_khz,
            row.i_a,
        );
        let z = z.unwrap();
        let r_pct = if row.r_ohm == 0.0 {
            assert!(z.r_ohm.abs() < 1e-12, "{row:?}: {z:?}");
            None
        } else {
            Some(100.0 * (z.r_ohm / row.r_ohm - 1.0))
        };
        (r_pct, 100.0 * (1e6 * z.l_h / row.l_uh - 1.0))
    };
    rows.iter().map(difference).collect()
}

fn check(rows: &[Row], found: &[(Option<f64>, f64)]) {
    let mut wrong = String::new();
    for (row, (r_pct, l_pct)) in rows.iter().zip(found) {
        let (r_limit, l_limit) = row.limits_pct();
        if r_pct.is_some_and(|r| r.abs() > r_limit) || l_pct.abs() > l_limit {
            let _ = writeln!(wrong, "{row:?}: R {r_pct:.2?} %, L {l_pct:.2} %");
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

#[test]
fn model_is_near_finite_elements() {
    let short = |row: &Row| {
        let usual = row.lift_mm == 0.0 && row.f_khz != 45.0;
        SHORT_MM.contains(&row.diameter_mm) && (usual || row.i_a > 0.0)
    };
    let rows: Vec<Row> = Row::all().into_iter().filter(short).collect();
    assert!(rows.len() > 40, "{} rows", rows.len());
    check(&rows, &differences(&rows));
}

#[test]
fn model_is_near_finite_elements_at_length() {
    let rows = Row::all();
    let found = differences(&rows);
    let text = table(&rows, &found);
    let command = "cargo test -p ihd-field --test oracle";
    document::hold("simulator.md", "finite elements", &text, command);
    check(&rows, &found);
}

/// Table of all differences: one line an arrangement.
fn table(rows: &[Row], found: &[(Option<f64>, f64)]) -> String {
    let stamp = FINITE_ELEMENTS
        .lines()
        .next()
        .unwrap()
        .trim_start_matches("# ");
    let mut out = format!(
        "Generated: `UPDATE_DOCS=1 cargo test -p ihd-field --test oracle` from tests/field-oracle/field.csv ({stamp}). \
         Turns calibration 1, aluminium shield of 1 mm, base of 5 mm, no wall, no lift where nothing else is said; \
         a wall is 2 mm thick; clad is aluminium on a ferritic foil of 0.5 mm, both within the 5 mm.\n\n\
         Model less finite elements in percent, R / L; limits ±2 / ±1 for linear metals, ±1 / ±1 with saturation.\n\n\
         | pot | 30 kHz | 45 kHz | 80 kHz |\n|---|---|---|---|\n"
    );
    let mut cells: Vec<(String, BTreeMap<String, String>)> = Vec::new();
    for (row, (r_pct, l_pct)) in rows.iter().zip(found) {
        let mut name = row.arrangement();
        if row.i_a > 0.0 {
            let _ = write!(name, ", {} A", row.i_a);
        }
        let r = r_pct.map_or("–".to_owned(), |r| format!("{r:+.2}"));
        let cell = format!("{r} / {l_pct:+.2}");
        let at = cells.iter().position(|(known, _)| *known == name);
        let at = at.unwrap_or_else(|| {
            cells.push((name, BTreeMap::new()));
            cells.len() - 1
        });
        cells[at].1.insert(row.f_khz.to_string(), cell);
    }
    for (name, by_f) in cells {
        let at = |f: &str| by_f.get(f).map_or("", String::as_str);
        let _ = writeln!(
            out,
            "| {name} | {} | {} | {} |",
            at("30"),
            at("45"),
            at("80")
        );
    }
    out
}
