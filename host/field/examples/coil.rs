//! R and L of one's own coil and load: `cargo run -p ihd-field --example coil tests/field-oracle/coil.toml`.
//!
//! The same file gives the finite elements' numbers: `python compare.py coil.toml` in tests/field-oracle.

use std::error::Error;

use ihd_field::model::FieldSettings;
use ihd_field::{FieldModel, Material, harmonic};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args()
        .nth(1)
        .ok_or("name a TOML file with [[case]] entries")?;
    let file: toml::Table = std::fs::read_to_string(&path)?.parse()?;
    let cases = file.get("case").and_then(toml::Value::as_array);
    for case in cases.ok_or(format!("{path}: no [[case]]"))? {
        let case = case.as_table().ok_or("a case is a table")?;
        print(case).map_err(|e| format!("{path}: {e}"))?;
    }
    Ok(())
}

fn number(key: &str, value: &toml::Value) -> Result<f64, String> {
    let whole = value.as_integer().map(|n| n as f64);
    value
        .as_float()
        .or(whole)
        .ok_or(format!("{key} is not a number"))
}

fn print(case: &toml::Table) -> Result<(), Box<dyn Error>> {
    let mut s = FieldSettings::paper();
    s.geometry.turns_calibration = 1.0;
    let (mut name, mut f_hz, mut i_a) = ("", 45e3, 0.0);
    let (mut metal, mut foil) = (None, None);
    for (key, value) in case {
        let g = &mut s.geometry;
        let field = match key.as_str() {
            "name" => {
                name = value.as_str().unwrap_or_default();
                continue;
            }
            "metal" => {
                metal = value.as_table();
                continue;
            }
            "foil" => {
                foil = value.as_table();
                continue;
            }
            "f_hz" => &mut f_hz,
            "current_a" => &mut i_a,
            "turns" => &mut g.turns,
            "coil_inner_m" => &mut g.coil_inner_m,
            "coil_outer_m" => &mut g.coil_outer_m,
            "coil_thickness_m" => &mut g.coil_thickness_m,
            "load_gap_m" => &mut g.load_gap_m,
            "load_radius_m" => &mut g.load_radius_m,
            "load_thickness_m" => &mut g.load_thickness_m,
            "foil_thickness_m" => &mut g.foil_thickness_m,
            "wall_height_m" => &mut g.wall_height_m,
            "wall_thickness_m" => &mut g.wall_thickness_m,
            "ferrite_gap_m" => &mut g.ferrite_gap_m,
            "ferrite_thickness_m" => &mut g.ferrite_thickness_m,
            "ferrite_radius_m" => &mut g.ferrite_radius_m,
            "ferrite_mu_r" => &mut g.ferrite_mu_r,
            "shield_gap_m" => &mut g.shield_gap_m,
            "shield_thickness_m" => &mut g.shield_thickness_m,
            other => return Err(format!("unknown key {other}").into()),
        };
        *field = number(key, value)?;
    }
    if let Some(foil) = foil {
        s.foil = material(foil)?;
    }
    let model = match metal {
        None => FieldModel::bare_coil(&s)?,
        Some(metal) => {
            s.material = material(metal)?;
            FieldModel::new(&s)?
        }
    };
    let z = harmonic::impedance(&model, f_hz, i_a)?;
    println!("{name:24} {:9.5} ohm {:9.4} µH", z.r_ohm, 1e6 * z.l_h);
    Ok(())
}

fn material(metal: &toml::Table) -> Result<Material, String> {
    let get = |key: &str| number(key, metal.get(key).ok_or(format!("metal has no {key}"))?);
    let (mu_r, sigma_s_per_m) = (get("mu_r")?, get("sigma_s_per_m")?);
    if metal.contains_key("alpha_a_per_m") {
        let alpha_a_per_m = get("alpha_a_per_m")?;
        let mu = mu_r * ihd_field::material::MU_0;
        return Ok(Material::Froehlich {
            alpha_a_per_m,
            b_per_t: 1.0 / (alpha_a_per_m * mu),
            sigma_s_per_m,
        });
    }
    Ok(Material::Linear {
        mu_r,
        sigma_s_per_m,
    })
}
