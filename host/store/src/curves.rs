//! R(t) and L(t) of a stored window, thinned: the network's result, and the truth if it is known.

use rusqlite::{OptionalExtension, Row, params};
use zstd::bulk::Decompressor;

use serde::{Deserialize, Serialize};

use super::windows::Day;
use super::{SessionId, Store, StoreError, payload};

/// Most points of a stored curve.
pub const MAX_POINTS: usize = 128;

/// Columns without standard deviations, and with them.
const COLUMNS: [usize; 2] = [4, 6];

/// zstd's level.
const LEVEL: i32 = 3;

/// R(t) and L(t) of a half-cycle. The lists are equally long; those of the standard deviations may be empty.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StoredCurve {
    /// Seconds after the mains zero crossing.
    pub t_s: Vec<f64>,
    /// R in ohm.
    pub r_ohm: Vec<f64>,
    /// L in henry.
    pub l_h: Vec<f64>,
    /// Amplitude of the current's fundamental, in ampere.
    pub i_a: Vec<f64>,
    /// Standard deviation of R, in ohm; empty if unknown.
    pub r_sigma_ohm: Vec<f64>,
    /// Standard deviation of L, in henry; empty if unknown.
    pub l_sigma_h: Vec<f64>,
}

impl StoredCurve {
    /// Returns `true` if the lists are equally long and not longer than [`MAX_POINTS`].
    pub fn is_sound(&self) -> bool {
        let n = self.t_s.len();
        let whole = [&self.r_ohm, &self.l_h, &self.i_a];
        let may_miss = [&self.r_sigma_ohm, &self.l_sigma_h];
        n <= MAX_POINTS
            && whole.iter().all(|x| x.len() == n)
            && may_miss.iter().all(|x| x.is_empty() || x.len() == n)
    }

    /// Returns at most [`MAX_POINTS`] of its points, evenly chosen, with the first and the last.
    #[must_use]
    pub fn thinned(&self) -> Self {
        let n = self.t_s.len();
        if n <= MAX_POINTS {
            return self.clone();
        }
        let last = (MAX_POINTS - 1) as f64;
        let chosen = |k: usize| (k as f64 * (n - 1) as f64 / last).round() as usize;
        let thin = |x: &Vec<f64>| {
            let points = (0..MAX_POINTS).filter_map(|k| x.get(chosen(k)).copied());
            points.collect::<Vec<f64>>()
        };
        Self {
            t_s: thin(&self.t_s),
            r_ohm: thin(&self.r_ohm),
            l_h: thin(&self.l_h),
            i_a: thin(&self.i_a),
            r_sigma_ohm: thin(&self.r_sigma_ohm),
            l_sigma_h: thin(&self.l_sigma_h),
        }
    }

    fn columns(&self) -> Vec<&[f64]> {
        let all: [&[f64]; 6] = [
            &self.t_s,
            &self.r_ohm,
            &self.l_h,
            &self.i_a,
            &self.r_sigma_ohm,
            &self.l_sigma_h,
        ];
        let n = self.t_s.len();
        let has_sigma = self.r_sigma_ohm.len() == n && self.l_sigma_h.len() == n;
        let columns = if has_sigma { COLUMNS[1] } else { COLUMNS[0] };
        all.into_iter().take(columns).collect()
    }

    /// Packs the curve with zstd and its checksum; `None` if the columns are not equally long.
    fn pack(&self) -> std::io::Result<Option<Vec<u8>>> {
        let columns = self.columns();
        let n = self.t_s.len();
        if n == 0 || columns.iter().any(|column| column.len() != n) {
            return Ok(None);
        }
        let values = columns.iter().flat_map(|column| column.iter());
        let bytes: Vec<u8> = values.flat_map(|x| (*x as f32).to_le_bytes()).collect();
        payload::compressor(LEVEL)?.compress(&bytes).map(Some)
    }

    fn unpack(bytes: &[u8], points: usize) -> Result<Self, String> {
        if points == 0 || points > MAX_POINTS {
            return Err(format!(
                "it declares {points} points, not 1 to {MAX_POINTS}"
            ));
        }
        let mut decompressor = Decompressor::new().map_err(|e| e.to_string())?;
        let raw = decompressor
            .decompress(bytes, COLUMNS[1] * points * size_of::<f32>())
            .map_err(|e| format!("its curve cannot be unpacked: {e}"))?;
        let (values, rest) = raw.as_chunks::<4>();
        let columns = values.len() / points;
        if !rest.is_empty() || values.len() % points != 0 || !COLUMNS.contains(&columns) {
            let got = raw.len();
            return Err(format!("a curve of {points} points of {got} bytes"));
        }
        let mut columns = values.chunks(points).map(|column| {
            let value = |b: &[u8; 4]| f64::from(f32::from_le_bytes(*b));
            column.iter().map(value).collect::<Vec<f64>>()
        });
        let mut next = || columns.next().unwrap_or_default();
        Ok(Self {
            t_s: next(),
            r_ohm: next(),
            l_h: next(),
            i_a: next(),
            r_sigma_ohm: next(),
            l_sigma_h: next(),
        })
    }
}

/// Curves of one window.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// The network's result.
    pub network: Option<StoredCurve>,
    /// The truth.
    pub truth: Option<StoredCurve>,
}

/// Source of a curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurveSource {
    /// The network's result.
    Network,
    /// The truth.
    Truth,
}

impl CurveSource {
    /// Returns its columns: number of points, and the packed curve.
    fn columns(self) -> [&'static str; 2] {
        match self {
            Self::Network => ["network_points", "network_zst"],
            Self::Truth => ["truth_points", "truth_zst"],
        }
    }
}

impl Day {
    /// Stores a curve of a window; returns `false` if the window's samples are not stored.
    fn keep_curve(
        &self,
        (device, boot, seq): (&str, u32, u32),
        of: CurveSource,
        curve: &StoredCurve,
    ) -> Result<bool, StoreError> {
        let packing = StoreError::files(self.path(), "packing a curve");
        let Some(packed) = curve.pack().map_err(packing)? else {
            return Ok(true);
        };
        let [points_of, packed_of] = of.columns();
        let sql = format!(
            "INSERT INTO trajectories (device, boot, seq, {points_of}, {packed_of})
             SELECT device, boot, seq, ?4, ?5 FROM windows
             WHERE device = ?1 AND boot = ?2 AND seq = ?3 AND pairs_zst IS NOT NULL
             ON CONFLICT (device, boot, seq) DO UPDATE
             SET {points_of} = excluded.{points_of}, {packed_of} = excluded.{packed_of}"
        );
        let points = curve.t_s.len() as i64;
        let rows = self
            .connection
            .execute(&sql, params![device, boot, seq, points, packed])
            .map_err(StoreError::database(self.path(), "storing a curve"))?;
        Ok(rows > 0)
    }

    /// Returns the curves of a window.
    pub(crate) fn curves(&self, device: &str, boot: u32, seq: u32) -> Result<Curves, StoreError> {
        if !self.has_table("trajectories")? {
            return Ok(Curves::default());
        }
        let sql = "SELECT network_points, network_zst, truth_points, truth_zst FROM trajectories
            WHERE device = ?1 AND boot = ?2 AND seq = ?3";
        type Packed = Option<(u32, Vec<u8>)>;
        let packed = |row: &Row<'_>, k: usize| -> rusqlite::Result<Packed> {
            Ok(row.get::<_, Option<u32>>(k)?.zip(row.get(k + 1)?))
        };
        let curves = self
            .connection
            .query_row(sql, params![device, boot, seq], |row| {
                Ok((packed(row, 0)?, packed(row, 2)?))
            })
            .optional()
            .map_err(StoreError::database(self.path(), "reading a curve"))?;
        let Some((network, truth)) = curves else {
            return Ok(Curves::default());
        };
        let unpack = |packed: Packed| {
            let curve = packed.map(|(points, bytes)| StoredCurve::unpack(&bytes, points as usize));
            curve.transpose().map_err(|why| StoreError::Window {
                file: self.path().to_owned(),
                device: device.to_owned(),
                boot,
                seq,
                why,
            })
        };
        Ok(Curves {
            network: unpack(network)?,
            truth: unpack(truth)?,
        })
    }
}

impl Store {
    /// Stores a curve beside a window's samples, thinned to [`MAX_POINTS`]. Without samples the curve is not stored,
    /// because nothing could be compared with it.
    ///
    /// # Errors
    /// [`StoreError::NoSession`], or an error of the database.
    pub fn keep_curve(
        &mut self,
        session: SessionId,
        seq: u32,
        of: CurveSource,
        curve: &StoredCurve,
    ) -> Result<(), StoreError> {
        let session = self.session(session)?;
        let (name, boot) = (session.name.clone(), session.boot);
        let curve = curve.thinned();
        for day in self.days.each() {
            if day.keep_curve((&name, boot, seq), of, &curve)? {
                break;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(n: usize, sigma: bool) -> StoredCurve {
        let of = |scale: f64| (0..n).map(|k| scale * (1.0 + k as f64)).collect::<Vec<_>>();
        StoredCurve {
            t_s: of(1e-5),
            r_ohm: of(0.1),
            l_h: of(1e-7),
            i_a: of(0.25),
            r_sigma_ohm: if sigma { of(1e-3) } else { Vec::new() },
            l_sigma_h: if sigma { of(1e-9) } else { Vec::new() },
        }
    }

    #[test]
    fn what_is_packed_is_unpacked_to_seven_digits() {
        for sigma in [true, false] {
            let curve = curve(100, sigma);
            let packed = curve.pack().unwrap().unwrap();
            let back = StoredCurve::unpack(&packed, 100).unwrap();
            let near = |a: &[f64], b: &[f64]| {
                a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a / b - 1.0).abs() < 1e-7)
            };
            assert!(near(&back.t_s, &curve.t_s) && near(&back.r_ohm, &curve.r_ohm));
            assert!(near(&back.l_h, &curve.l_h) && near(&back.i_a, &curve.i_a));
            assert!(near(&back.r_sigma_ohm, &curve.r_sigma_ohm));
            assert!(near(&back.l_sigma_h, &curve.l_sigma_h));
            assert!(StoredCurve::unpack(&packed, 99).is_err(), "another length");
            let mut broken = packed.clone();
            let last = broken.len() - 6;
            broken[last] ^= 1;
            assert!(StoredCurve::unpack(&broken, 100).is_err(), "the checksum");
        }
        assert_eq!(StoredCurve::default().pack().unwrap(), None);
        assert!(StoredCurve::unpack(&[], 1 << 30).is_err());
    }

    #[test]
    fn thinning_keeps_both_ends() {
        let thin = curve(10_000, true).thinned();
        assert_eq!(thin.t_s.len(), MAX_POINTS);
        assert_eq!(
            (thin.t_s[0], thin.t_s[MAX_POINTS - 1]),
            (1e-5, 1e-5 * 10_000.0)
        );
        assert_eq!(thin.l_sigma_h.len(), MAX_POINTS);
        assert_eq!(curve(128, false).thinned(), curve(128, false));
    }
}
