//! Room for the newest windows: samples of older ones are deleted, tier by tier (thinning.rs).

use rusqlite::params;

use super::folder::{self, DayFile};
use super::thinning::{Candidate, Cursor, ImpedanceEstimate, Tier};
use super::windows::{Day, SampleDropReason};
use super::{Store, StoreError, clock};

/// Windows of one transaction.
const A_BATCH: usize = 64;

/// Windows that are examined before another one is stored: some 10 ms.
const A_ROUND: usize = 512;

/// Windows of the last hour that are thinned together if nothing older is left.
const THINNED_WINDOWS: usize = 8;

const IDENTIFIED: &str = "
SELECT r_ohm, l_h, sigma_r_pct, sigma_l_pct, pass FROM results
WHERE device = (SELECT id FROM devices WHERE name = ?1) AND boot = ?2 AND seq = ?3";

impl Store {
    /// Returns the bytes of windows beyond their limit.
    pub(crate) fn excess_bytes(&self) -> Result<u64, StoreError> {
        let bytes = self.other_days_bytes.saturating_add(self.today_bytes()?);
        Ok(bytes.saturating_sub(self.options().retention.max_bytes))
    }

    /// Makes room until all windows fit, for one round at most; the next stored window continues.
    pub(crate) fn make_room(&mut self) -> Result<(), StoreError> {
        let mut looked_at = 0;
        while looked_at < A_ROUND && self.excess_bytes()? > 0 {
            if self.give_back()? {
                looked_at += A_BATCH;
                continue;
            }
            if self.delete_oldest(folder::cannot_shrink)? {
                continue;
            }
            looked_at += match self.thin_older()? {
                Some(windows) => windows,
                None if self.delete_oldest_but_recent()? => 0,
                None => match self.drop_oldest()? {
                    0 if self.delete_oldest(|_| true)? => 0,
                    0 => return Ok(()),
                    windows => windows,
                },
            };
        }
        Ok(())
    }

    /// Gives unused pages of past days back to the disk; returns `false` if there are none.
    fn give_back(&mut self) -> Result<bool, StoreError> {
        let mut freed = 0;
        for day in self.days.before.iter().chain(&self.days.thinned) {
            freed += day.give_back()?;
        }
        self.other_days_bytes = self.other_days_bytes.saturating_sub(freed);
        Ok(freed > 0)
    }

    /// Continues the first tier that is not finished; `None` if both are.
    fn thin_older(&mut self) -> Result<Option<usize>, StoreError> {
        let mut thinning = std::mem::take(&mut self.thinning);
        let mut looked_at = self.thin(&mut thinning.changes);
        if matches!(looked_at, Ok(None)) {
            looked_at = self.thin(&mut thinning.minutes);
        }
        self.thinning = thinning;
        looked_at
    }

    /// Moves a cursor past a batch of windows older than an hour; `None` if there are none.
    fn thin(&mut self, cursor: &mut Cursor) -> Result<Option<usize>, StoreError> {
        let days = self.in_order()?;
        let at = days.iter().position(|file| file.day == cursor.day);
        let at = at.unwrap_or_else(|| days.partition_point(|file| file.day < cursor.day));
        for file in days.into_iter().skip(at) {
            if file.day != cursor.day {
                cursor.turn_to(&file.day);
            }
            let until = self.recent.first_of(&file.day);
            match self.thin_file(file, cursor, until, A_BATCH) {
                Ok(0) => {}
                Ok(windows) => return Ok(Some(windows)),
                // The next start sets it aside.
                Err(error) if error.is_damage() => {
                    tracing::warn!(%error, "a day that cannot be thinned");
                    cursor.after = i64::MAX;
                }
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    fn thin_file(
        &mut self,
        file: DayFile,
        cursor: &mut Cursor,
        until: Option<i64>,
        limit: usize,
    ) -> Result<usize, StoreError> {
        let (place, day) = self.take_day(file)?;
        let windows = day.with_samples(cursor.after, until, limit);
        let thinned = windows.and_then(|windows| self.thin_day(&day, cursor, &windows));
        *self.place(place) = Some(day);
        thinned
    }

    fn delete_oldest_but_recent(&mut self) -> Result<bool, StoreError> {
        let mut days = folder::days(self.folder())?;
        days.retain(|file| self.recent.first_of(&file.day).is_some());
        self.delete_oldest(|path| days.iter().all(|file| file.path != *path))
    }

    /// Deletes the samples of the oldest windows that are left; returns the number of windows.
    fn drop_oldest(&mut self) -> Result<usize, StoreError> {
        for file in self.in_order()? {
            let mut cursor = Cursor::new(Tier::Nothing);
            match self.thin_file(file, &mut cursor, None, THINNED_WINDOWS)? {
                0 => {}
                windows => return Ok(windows),
            }
        }
        Ok(0)
    }

    /// Returns the days, the oldest first and today's last, also if the clock was set back.
    fn in_order(&self) -> Result<Vec<DayFile>, StoreError> {
        let today = clock::day(self.now());
        let mut days = folder::days(self.folder())?;
        days.sort_by_key(|file| file.day == today);
        Ok(days)
    }

    fn thin_day(
        &mut self,
        day: &Day,
        cursor: &mut Cursor,
        windows: &[Candidate],
    ) -> Result<usize, StoreError> {
        let (mut gone, mut lost) = (Vec::new(), 0);
        for window in windows {
            let (identified, has_result) = self.identified(window)?;
            if !cursor.pass(window, identified) {
                let is_given_up = window.is_unanswered && !has_result;
                lost += u64::from(is_given_up);
                gone.push((window, is_given_up));
            }
        }
        day.thin(&gone, SampleDropReason::Thinned, self.now())?;
        self.tallies.remove(&day.file.day);
        self.figures_mut().thinned += gone.len() as u64;
        if lost > 0 {
            *self.lost_to_fleet.entry(day.file.day.clone()).or_default() += lost;
        }
        Ok(windows.len())
    }

    /// Returns R and L of a window if the gate accepts it, and `true` if there is any result.
    fn identified(
        &self,
        window: &Candidate,
    ) -> Result<(Option<ImpedanceEstimate>, bool), StoreError> {
        use rusqlite::OptionalExtension;
        let of = params![window.device, window.boot, window.seq];
        let mut statement = self
            .records()
            .prepare(IDENTIFIED)
            .map_err(self.failed("looking for a result"))?;
        let result = statement.query_row(of, |row| {
            let real = |k: usize| row.get::<_, Option<f64>>(k);
            let identified = ImpedanceEstimate {
                r_ohm: real(0)?.unwrap_or(f64::NAN),
                l_h: real(1)?.unwrap_or(f64::NAN),
                sigma_r_pct: real(2)?.unwrap_or(f64::NAN),
                sigma_l_pct: real(3)?.unwrap_or(f64::NAN),
            };
            let is_good = row.get(4)? && identified.r_ohm.is_finite() && identified.l_h.is_finite();
            Ok(is_good.then_some(identified))
        });
        let result = result
            .optional()
            .map_err(self.failed("looking for a result"))?;
        Ok((result.flatten(), result.is_some()))
    }

    /// Takes a day's database out of the open ones, or opens it; returns it with its place.
    fn take_day(&mut self, file: DayFile) -> Result<(OpenDay, Day), StoreError> {
        for place in [OpenDay::Today, OpenDay::Before, OpenDay::Thinned] {
            if let Some(day) = self.place(place).take_if(|day| day.file == file) {
                return Ok((place, day));
            }
        }
        Ok((OpenDay::Thinned, Day::open(file)?))
    }

    fn place(&mut self, place: OpenDay) -> &mut Option<Day> {
        match place {
            OpenDay::Today => &mut self.days.today,
            OpenDay::Before => &mut self.days.before,
            OpenDay::Thinned => &mut self.days.thinned,
        }
    }
}

/// Place of an open day.
#[derive(Clone, Copy)]
enum OpenDay {
    Today,
    Before,
    Thinned,
}
