//! Acknowledgements of a batch, all waited for at once.

use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use tokio::time::Instant;

/// Acknowledgements that are still to come, each with what it is of.
pub type UnderWay<T> = FuturesUnordered<BoxFuture<'static, T>>;

/// Gives each that comes until then to `heard`; false where some did not come.
pub async fn all_until<T>(
    under_way: &mut UnderWay<T>,
    deadline: Instant,
    mut heard: impl FnMut(T),
) -> bool {
    loop {
        match tokio::time::timeout_at(deadline, under_way.next()).await {
            Ok(Some(one)) => heard(one),
            Ok(None) => return true,
            Err(_) => return false,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const S: Duration = Duration::from_secs(1);

    /// Comes after so many seconds.
    fn after(seconds: u32) -> BoxFuture<'static, u32> {
        Box::pin(async move {
            tokio::time::sleep(seconds * S).await;
            seconds
        })
    }

    #[tokio::test(start_paused = true)]
    async fn a_batch_has_one_deadline_however_many_stay_away() {
        let began = Instant::now();
        let mut under_way: UnderWay<u32> = (1..=64).map(after).collect();
        let mut heard = Vec::new();
        let all = all_until(&mut under_way, began + 8 * S + S / 2, |one| heard.push(one)).await;
        assert!(!all);
        assert_eq!(heard, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(began.elapsed(), 8 * S + S / 2);
        let mut under_way: UnderWay<u32> = [after(3), after(1), after(3)].into_iter().collect();
        let began = Instant::now();
        assert!(all_until(&mut under_way, began + 8 * S, |_| {}).await);
        assert_eq!(
            began.elapsed(),
            3 * S,
            "at once, and not one after the other"
        );
    }
}
