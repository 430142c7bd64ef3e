//! Acknowledgements of a batch, awaited together.

use futures_util::StreamExt;
use futures_util::future::BoxFuture;
use futures_util::stream::FuturesUnordered;
use tokio::time::Instant;

/// Acknowledgements still to come, each with its message.
pub type PendingAcks<T> = FuturesUnordered<BoxFuture<'static, T>>;

/// Passes each one that comes before the deadline to `on_ack`; returns `false` if some did not come.
pub async fn all_until<T>(
    pending: &mut PendingAcks<T>,
    deadline: Instant,
    mut on_ack: impl FnMut(T),
) -> bool {
    loop {
        match tokio::time::timeout_at(deadline, pending.next()).await {
            Ok(Some(one)) => on_ack(one),
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

    /// Returns an acknowledgement that comes after a number of seconds.
    fn after(seconds: u32) -> BoxFuture<'static, u32> {
        Box::pin(async move {
            tokio::time::sleep(seconds * S).await;
            seconds
        })
    }

    #[tokio::test(start_paused = true)]
    async fn a_batch_has_one_deadline_however_many_stay_away() {
        let began = Instant::now();
        let mut under_way: PendingAcks<u32> = (1..=64).map(after).collect();
        let mut received = Vec::new();
        let all = all_until(&mut under_way, began + 8 * S + S / 2, |one| {
            received.push(one)
        })
        .await;
        assert!(!all);
        assert_eq!(received, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(began.elapsed(), 8 * S + S / 2);
        let mut under_way: PendingAcks<u32> = [after(3), after(1), after(3)].into_iter().collect();
        let began = Instant::now();
        assert!(all_until(&mut under_way, began + 8 * S, |_| {}).await);
        assert_eq!(
            began.elapsed(),
            3 * S,
            "at once, and not one after the other"
        );
    }
}
