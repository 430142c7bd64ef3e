//! Distribution of a study's jobs over all cores.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Applies `work` to every job on as many threads as there are cores; results are in the jobs' order.
///
/// # Panics
/// If `work` panics.
pub fn in_parallel<J: Sync, R: Send>(jobs: &[J], work: impl Fn(&J) -> R + Sync) -> Vec<R> {
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..workers.min(jobs.len()) {
            scope.spawn(|| {
                while let Some((k, job)) =
                    Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|k| Some((k, jobs.get(k)?)))
                {
                    let result = work(job);
                    results
                        .lock()
                        .unwrap_or_else(PoisonError::into_inner)
                        .push((k, result));
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_else(PoisonError::into_inner);
    results.sort_by_key(|(k, _)| *k);
    results.into_iter().map(|(_, r)| r).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jobs_keep_their_order_on_any_number_of_threads() {
        let jobs: Vec<u64> = (0..100).collect();
        let squares = in_parallel(&jobs, |j| {
            std::thread::sleep(std::time::Duration::from_micros((100 - j) * 10));
            j * j
        });
        assert_eq!(squares, jobs.iter().map(|j| j * j).collect::<Vec<_>>());
    }
}
