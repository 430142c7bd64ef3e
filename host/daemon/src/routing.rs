//! From what was learned to the store, and to the device.

use std::sync::{Arc, Weak};

use ihd_shared::lookup::RlLookup;
use tokio::sync::mpsc;

use crate::device::Order;
use crate::learning::{Learned, Learner};
use crate::model::What;
use crate::printable::printable;
use crate::store_thread::StoreThread;
use crate::supervisor::Devices;

/// Takes what was learned until nobody learns any more.
pub async fn route(
    mut outcomes: mpsc::Receiver<Learned>,
    devices: Arc<Devices>,
    store: StoreThread,
    learner: Weak<Learner>,
) {
    while let Some(learned) = outcomes.recv().await {
        let (device, news) = (learned.device.clone(), learned.news.clone());
        settle(learned, &devices, &store).await;
        let Some(built) = news else { continue };
        let version = built.lookup.version;
        if !push(&devices, &device, built.lookup)
            && let Some(learner) = learner.upgrade()
        {
            // It is built again from what comes next.
            learner.refused(&device, version);
        }
    }
}

/// Counts it, stores it, tells it.
async fn settle(learned: Learned, devices: &Devices, store: &StoreThread) {
    let handle = devices.get(&learned.device);
    if let Some(handle) = &handle {
        let mut inner = handle.face.lock();
        match learned.result.pass {
            true => inner.ledger.fates.learned += 1,
            false => inner.ledger.fates.unfit += 1,
        }
    }
    let result = learned.result;
    let what = What::ResultStored {
        boot: learned.boot,
        seq: result.seq,
        f_sw_hz: result.f_sw_hz,
        r_ohm: result.r_ohm,
        l_h: result.l_h,
        pass: result.pass,
        why: printable(&result.why),
    };
    let (state, device_id) = (learned.state, learned.device_id);
    let no_lookup = learned.no_lookup.map(|why| printable(&why));
    if let Some(why) = &no_lookup {
        tracing::info!(device = learned.device, why, "no lookup");
    }
    let stored = store.run(move |store| {
        store.record_result(&result, state.as_deref())?;
        match no_lookup {
            Some(why) => store.event(Some(device_id), "no lookup", &why),
            None => Ok(()),
        }
    });
    // The store's trouble is told by its thread.
    if stored.await.is_ok()
        && let Some(handle) = handle
    {
        handle.face.tell(what);
    }
}

/// Gives a lookup to the device's task; false where it is not there, or has too much to do.
fn push(devices: &Devices, device: &str, lookup: RlLookup) -> bool {
    let order = Order::News(Box::new(lookup));
    let handle = devices.get(device);
    handle.is_some_and(|handle| handle.orders.try_send(order).is_ok())
}
