//! Lookup in ohm and henry, with deviation, confidence and age of its cells.

use std::f64::consts::{FRAC_PI_2, TAU};

use ihd_model::Map;
use ihd_shared::hob::RESONANCE_CAPACITANCE_NF;
use ihd_shared::lookup::RlLookup;
use ihd_shared::lookup::grid::{CURRENT_KNOTS_A, CURRENTS, FREQUENCIES, FREQUENCY_KNOTS_HZ};
use ihd_shared::lookup::prior::prior;
use ihd_signal::interpolation::linear;
use ihd_store::{Certainty, LookupRow};

use super::View;
use crate::error::DaemonError;
use crate::locking::lock;

impl View {
    /// Returns a lookup of a device as a map: of this version, 0 being the built-in prior; if `version` is `None`, the one
    /// that the device uses, or used last. `None` if there is no such version.
    ///
    /// # Errors
    /// [`DaemonError::NoDevice`], or an error of the store.
    pub async fn map(
        &self,
        device: &str,
        version: Option<u32>,
    ) -> Result<Option<Map>, DaemonError> {
        let handle = self.devices.get(device);
        let on_device = handle.and_then(|handle| handle.record.lock().lookup.on_device);
        let ages = lock(&self.ages).get(device).cloned().unwrap_or_default();
        let read = self.read_device(device, move |reader, device| {
            let row = reader.lookup(device, version.or(on_device))?;
            let version = version
                .or(on_device)
                .or(row.as_ref().map(|row| row.version));
            let version = version.unwrap_or(0);
            let mut ages = ages;
            ages.add(&reader.last_accepted(device, ages.last)?);
            let certainty = reader.certainty(device, version)?;
            Ok((version, row, certainty, ages))
        });
        let (version, row, certainty, ages) = read.await?;
        let age_s = ages.at(self.machine.now_ms());
        let map = map(version, row.as_ref(), certainty.as_ref(), age_s);
        lock(&self.ages).insert(device.to_owned(), ages);
        Ok(map)
    }
}

fn map(
    version: u32,
    row: Option<&LookupRow>,
    certainty: Option<&Certainty>,
    mut age_s: Vec<Vec<Option<f64>>>,
) -> Option<Map> {
    if version == 0 {
        let map = Map {
            state: "prior".to_owned(),
            origin: "firmware".to_owned(),
            why: "built into the firmware".to_owned(),
            ..Map::default()
        };
        return Some(fill(map, &prior(), vec![vec![None; CURRENTS]; FREQUENCIES]));
    }
    let row = row?;
    // The store checks lookups before writing them.
    let lookup = RlLookup::from_bytes(&row.blob).ok()?;
    let [sigma_r_pct, sigma_l_pct] = certainty
        .and_then(Certainty::sigma_pct)
        .map_or([None, None], |sigma| sigma.map(Some));
    let confidence = certainty.map(Certainty::confidence);
    let cells = age_s.iter_mut().flatten();
    for (age_s, confidence) in cells.zip(confidence.iter().flatten().flatten()) {
        // Without confidence the last result there was of a pot before this one.
        *age_s = age_s.filter(|_| *confidence > 0.0);
    }
    let map = Map {
        version,
        state: row.state.to_string(),
        at_ms: row.at_ms,
        origin: row.origin.clone(),
        why: row.why.clone(),
        sigma_r_pct,
        sigma_l_pct,
        confidence,
        ..Map::default()
    };
    Some(fill(map, &lookup, age_s))
}

fn fill(map: Map, lookup: &RlLookup, age_s: Vec<Vec<Option<f64>>>) -> Map {
    let (r_ohm, l_h) = (lookup.r_ohm(), lookup.l_h());
    let power_w = |f: usize| {
        let load = |i: usize| (r_ohm[f][i], l_h[f][i]);
        let row = MapRow::new(FREQUENCY_KNOTS_HZ[f], &CURRENT_KNOTS_A, load);
        (0..CURRENTS).map(|i| row.mean_power_w(i)).collect()
    };
    let observed = |f: usize| (0..CURRENTS).map(|i| lookup.is_observed(f, i)).collect();
    Map {
        r_ohm: r_ohm.map(Vec::from).into(),
        l_h: l_h.map(Vec::from).into(),
        power_w: (0..FREQUENCIES).map(power_w).collect(),
        observed: (0..FREQUENCIES).map(observed).collect(),
        age_s,
        f_sw_hz: FREQUENCY_KNOTS_HZ.to_vec(),
        i_a: CURRENT_KNOTS_A.to_vec(),
        ..map
    }
}

/// Points of a quarter of the mains period at which the power is taken.
const POWER_POINTS: usize = 32;

/// Halvings of an interval in which a current is searched: to 10⁻⁶ of it.
const HALVINGS: usize = 20;

/// Load at one switching frequency, linear between the columns.
struct MapRow<'a> {
    /// Currents of the columns in ampere.
    i_a: &'a [f64],
    r_ohm: Vec<f64>,
    /// |Z| of load and resonance capacitor in ohm.
    z_ohm: Vec<f64>,
}

impl<'a> MapRow<'a> {
    fn new(f_sw_hz: f64, i_a: &'a [f64], r_l: impl Fn(usize) -> (f64, f64)) -> Self {
        let omega = TAU * f_sw_hz;
        let c_f = 1e-9 * f64::from(RESONANCE_CAPACITANCE_NF);
        let z_ohm = |(r_ohm, l_h): (f64, f64)| r_ohm.hypot(omega * l_h - 1.0 / (omega * c_f));
        let loads: Vec<_> = (0..i_a.len()).map(r_l).collect();
        Self {
            i_a,
            r_ohm: loads.iter().map(|load| load.0).collect(),
            z_ohm: loads.into_iter().map(z_ohm).collect(),
        }
    }

    fn at(&self, values: &[f64], i_a: f64) -> f64 {
        linear(self.i_a, values, i_a).unwrap_or(f64::NAN)
    }

    /// Amplitude of the voltage's fundamental in volt at an amplitude of the current in ampere.
    fn voltage_v(&self, i_a: f64) -> f64 {
        self.at(&self.z_ohm, i_a) * i_a
    }

    /// Mean power over a half-cycle in watt, P = ⟨½ R(Î) Î²⟩, whose voltage follows |sin| up to that at the amplitude of a column.
    /// The current follows |sin| only where R and L are constant.
    fn mean_power_w(&self, column: usize) -> f64 {
        let crest_a = self.i_a[column];
        let crest_v = self.voltage_v(crest_a);
        let power = |point: usize| {
            let angle = FRAC_PI_2 * (point as f64 + 0.5) / POWER_POINTS as f64;
            let v = crest_v * angle.sin();
            let (mut below, mut above) = (0.0, crest_a);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (below + above);
                match self.voltage_v(middle) < v {
                    true => below = middle,
                    false => above = middle,
                }
            }
            0.5 * self.at(&self.r_ohm, above) * above * above
        };
        (0..POWER_POINTS).map(power).sum::<f64>() / POWER_POINTS as f64
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use ihd_store::{LastAccepted, LookupState};

    use super::super::cell_ages::CellAges;
    use super::*;

    #[test]
    fn cells_lie_where_the_firmware_interpolates_them() {
        let map = map(0, None, None, CellAges::default().at(0)).unwrap();
        assert_eq!(
            (map.state.as_str(), map.f_sw_hz.len(), map.i_a.len()),
            ("prior", 8, 17)
        );
        assert_eq!((map.f_sw_hz[0], map.i_a[0]), (30e3, 0.0));
        assert!((map.f_sw_hz[7] - 80e3).abs() < 1e-6 && (map.i_a[16] - 80.0).abs() < 1e-9);
        let lookup = prior();
        for (f, f_sw_hz) in map.f_sw_hz.iter().enumerate() {
            for (i, i_a) in map.i_a.iter().enumerate() {
                // The firmware's value at that point, with coordinates of 16 bits.
                let at = lookup.interpolate(f_sw_hz.round() as u32, (i_a * 1e3).round() as u32);
                let (r_ohm, l_h) = (map.r_ohm[f][i], map.l_h[f][i]);
                assert!((at.0.ohm() / r_ohm - 1.0).abs() < 2e-3, "R in {f}, {i}");
                assert!((at.1.henry() / l_h - 1.0).abs() < 2e-3, "L in {f}, {i}");
                assert!(!map.observed[f][i] && map.age_s[f][i].is_none());
            }
        }
        assert!(super::map(3, None, None, Vec::new()).is_none());
    }

    /// At resonance |Z| is R. A constant one gives half the power of the crest; R = a/√Î makes the current follow sin², and
    /// P = ½aÎ^1.5 ⟨|sin|³⟩ = 2aÎ^1.5 / 3π, which is less than half.
    #[test]
    fn the_power_of_a_cell_is_the_mean_over_a_half_cycle_of_the_voltage() {
        let f_sw_hz: f64 = 45e3;
        let resonant_h = 1e9 / (f64::from(RESONANCE_CAPACITANCE_NF) * (TAU * f_sw_hz).powi(2));
        let i_a: Vec<f64> = (0..=800).map(|k| 0.1 * f64::from(k)).collect();
        let power_w = |r: &dyn Fn(f64) -> f64| {
            MapRow::new(f_sw_hz, &i_a, |i| (r(i_a[i]), resonant_h)).mean_power_w(600)
        };
        let constant = power_w(&|_| 4.0);
        assert!((constant / (0.25 * 4.0 * 3_600.0) - 1.0).abs() < 1e-3);
        let falling = power_w(&|i_a| 20.0 / i_a.max(0.1).sqrt());
        let exact = 2.0 * 20.0 * 60.0_f64.powf(1.5) / (3.0 * PI);
        assert!((falling / exact - 1.0).abs() < 2e-3, "{falling} {exact}");
    }

    #[test]
    fn a_cell_that_the_lookup_does_not_know_has_no_age() {
        let lookup = RlLookup {
            version: 3,
            ..prior()
        };
        let row = LookupRow {
            device: "bench".to_owned(),
            version: 3,
            state: LookupState::Active,
            origin: "host".to_owned(),
            at_ms: 0,
            why: String::new(),
            blob: lookup.to_bytes().to_vec(),
        };
        let mut confidence = [[0.0; CURRENTS]; FREQUENCIES];
        confidence[2][3] = 0.1;
        let certainty = Certainty::quantise(&confidence, &[[[0.01; CURRENTS]; FREQUENCIES]; 2]);
        let ages = || vec![vec![Some(7.0); CURRENTS]; FREQUENCIES];
        let map = |version, certainty| map(version, Some(&row), certainty, ages()).unwrap();
        let known = map(3, Some(&certainty));
        assert_eq!(known.age_s[2][3], Some(7.0));
        assert_eq!(known.age_s.iter().flatten().flatten().count(), 1);
        assert_eq!(map(0, None).age_s.iter().flatten().flatten().count(), 0);
        assert_eq!(map(3, None).age_s, ages(), "pushed by hand: nobody knows");
    }

    #[test]
    fn a_result_is_news_for_the_rows_around_it_up_to_its_crest() {
        let mut ages = CellAges::default();
        let accepted = |last, at_ms, f_sw_hz, i_crest_a| LastAccepted {
            last,
            at_ms,
            f_sw_hz,
            i_crest_a,
        };
        // 45 kHz lies between the rows of 39.7 and 45.7 kHz, 20 A between the columns of 17.0 and 21.3 A.
        ages.add(&[
            accepted(7, 1_000, 45_000, 20.0),
            accepted(5, 500, 45_000, 79.0),
        ]);
        assert_eq!(ages.last, 7);
        let age = ages.at(2_000);
        for (f, row) in age.iter().enumerate() {
            for (i, age) in row.iter().enumerate() {
                let expected = match (f, i) {
                    (2 | 3, 0..=10) if CURRENT_KNOTS_A[i - usize::from(i > 0)] < 20.0 => Some(1.0),
                    (2 | 3, _) => Some(1.5),
                    _ => None,
                };
                assert_eq!(*age, expected, "{f}, {i}");
            }
        }
        // Values out of range.
        ages.add(&[
            accepted(8, i64::MAX, u32::MAX, f64::INFINITY),
            accepted(9, 0, 0, -1.0),
        ]);
        assert_eq!(ages.at(0)[7][16], Some(0.0));
    }
}
