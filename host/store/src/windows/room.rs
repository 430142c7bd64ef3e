//! Room in a day's file: which windows still have samples, and how these are deleted and their pages given back.

use rusqlite::params;

use super::{Day, NO_SAMPLES, SampleDropReason};
use crate::error::StoreError;
use crate::thinning::Candidate;

/// Pages that are given back at once: 4 MiB.
const PAGES_AT_ONCE: i64 = 1_024;

impl Day {
    /// Returns the number of the last row; 0 for a day without windows.
    pub(crate) fn last_row(&self) -> Result<i64, StoreError> {
        let sql = "SELECT coalesce(max(id), 0) FROM windows";
        let last = self.connection.query_row(sql, [], |row| row.get(0));
        last.map_err(self.failed("looking for the last window"))
    }

    /// Returns the first row that was stored within `span_ms` before the last one, by bisection, and the time between them.
    pub(crate) fn first_row_within(&self, span_ms: i64) -> Result<(i64, i64), StoreError> {
        let at = |id: i64| {
            let sql = "SELECT at_ms FROM windows WHERE id <= ?1 ORDER BY id DESC LIMIT 1";
            let at = self
                .connection
                .query_row(sql, [id], |row| row.get::<_, i64>(0));
            at.map_err(self.failed("looking for the last windows"))
        };
        let (mut before, mut first) = (0, self.last_row()?);
        if first == 0 {
            return Ok((1, 0));
        }
        let last_ms = at(first)?;
        let from_ms = last_ms.saturating_sub(span_ms);
        while first - before > 1 {
            let middle = before + (first - before) / 2;
            match at(middle)? >= from_ms {
                true => first = middle,
                false => before = middle,
            }
        }
        Ok((first, last_ms.saturating_sub(at(first)?).clamp(0, span_ms)))
    }

    /// Returns windows with samples after a row and before another, in the order in which they came.
    pub(crate) fn with_samples(
        &self,
        after: i64,
        until: Option<i64>,
        limit: usize,
    ) -> Result<Vec<Candidate>, StoreError> {
        let read = || {
            let mut statement = self.connection.prepare(
                "SELECT id, device, boot, seq, at_ms, fleet IS 0 OR fleet IS 1
                 FROM windows INDEXED BY windows_with_samples
                 WHERE not_kept IS NULL AND id > ?1 AND id < ?2 ORDER BY id LIMIT ?3",
            )?;
            let until = until.unwrap_or(i64::MAX);
            let rows = statement.query_map(params![after, until, limit as i64], |row| {
                Ok(Candidate {
                    id: row.get(0)?,
                    device: row.get(1)?,
                    boot: row.get(2)?,
                    seq: row.get(3)?,
                    at_ms: row.get(4)?,
                    is_unanswered: row.get(5)?,
                })
            })?;
            rows.collect::<rusqlite::Result<_>>()
        };
        read().map_err(self.failed("looking for room"))
    }

    /// Deletes the samples of these windows; those with `true` are given up for the fleet.
    pub(crate) fn thin(
        &self,
        gone: &[(&Candidate, bool)],
        why: SampleDropReason,
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let thin = || {
            let change = self.connection.unchecked_transaction()?;
            {
                let mut windows = change.prepare(
                    "UPDATE windows SET not_kept = ?2, pairs_zst = NULL, trajectory_zst = NULL,
                     fleet = iif(?3, 2, fleet), fleet_end = iif(?3, ?4, fleet_end),
                     fleet_ms = iif(?3, ?5, fleet_ms) WHERE id = ?1",
                )?;
                let mut trajectories = change.prepare(
                    "DELETE FROM trajectories WHERE device = ?1 AND boot = ?2 AND seq = ?3",
                )?;
                for (window, is_given_up) in gone {
                    windows.execute(params![
                        window.id,
                        why.as_str(),
                        is_given_up,
                        NO_SAMPLES,
                        now_ms
                    ])?;
                    trajectories.execute(params![window.device, window.boot, window.seq])?;
                }
            }
            change.commit()
        };
        thin().map_err(self.failed("making room"))
    }

    /// Gives unused pages back to the disk, [`PAGES_AT_ONCE`] at most, so that no window waits long; returns the freed bytes.
    pub(crate) fn give_back(&self) -> Result<u64, StoreError> {
        let bytes = || -> Result<i64, StoreError> {
            let pages = self.pragma("page_count")?;
            Ok(pages.saturating_mul(self.pragma("page_size")?))
        };
        let before = bytes()?;
        let free = self.pragma("freelist_count")?.min(PAGES_AT_ONCE);
        if free == 0 {
            return Ok(0);
        }
        let vacuum = || {
            let sql = format!("PRAGMA incremental_vacuum({free})");
            let mut statement = self.connection.prepare(&sql)?;
            // Each row of the pragma's result frees one page.
            let mut rows = statement.query([])?;
            while rows.next()?.is_some() {}
            Ok(())
        };
        vacuum().map_err(self.failed("giving room back"))?;
        Ok(u64::try_from(before.saturating_sub(bytes()?)).unwrap_or(0))
    }

    fn pragma(&self, name: &str) -> Result<i64, StoreError> {
        let value = self
            .connection
            .pragma_query_value(None, name, |row| row.get(0));
        value.map_err(self.failed("measuring"))
    }

    /// Deletes a window's samples; returns `false` if there are none.
    pub(crate) fn drop_samples(
        &self,
        device: &str,
        boot: u32,
        seq: u32,
        why: SampleDropReason,
    ) -> Result<bool, StoreError> {
        let drop = || {
            let change = self.connection.unchecked_transaction()?;
            let rows = change.execute(
                "UPDATE windows SET not_kept = ?4, pairs_zst = NULL, trajectory_zst = NULL
                 WHERE device = ?1 AND boot = ?2 AND seq = ?3 AND pairs_zst IS NOT NULL",
                params![device, boot, seq, why.as_str()],
            )?;
            if rows > 0 {
                change.execute(
                    "DELETE FROM trajectories WHERE device = ?1 AND boot = ?2 AND seq = ?3",
                    params![device, boot, seq],
                )?;
            }
            change.commit()?;
            Ok(rows > 0)
        };
        drop().map_err(self.failed("dropping a window's samples"))
    }

    /// Returns the bytes in use; freed pages are reused before the file grows.
    pub(crate) fn used_bytes(&self) -> Result<u64, StoreError> {
        let pages = self.pragma("page_count")? - self.pragma("freelist_count")?;
        let bytes = pages.saturating_mul(self.pragma("page_size")?);
        Ok(u64::try_from(bytes).unwrap_or(0))
    }
}
