//! Queue of jobs for the store: a lane for each device and one for the daemon, served in turn. Plain data, driven by a thread or by a
//! simulation.
//!
//! A device that floods fills its own lane only and loses its own jobs. Every lane is served once before any is served twice. Memory
//! is bounded: [`ALL_DEVICES`] jobs, and [`GUARANTEED`] and [`RESERVE`] for each device.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Capacity of the daemon's own lane.
pub const DAEMON: usize = 128;

/// Largest capacity of one device's lane: its windows of some ten seconds, 4.5 MB.
pub const DEVICE: usize = 64;

/// Capacity of all devices' lanes together, 36 MB of windows, shared evenly by the devices with jobs.
pub const ALL_DEVICES: usize = 512;

/// Capacity of a device's lane that other devices cannot use.
pub const GUARANTEED: usize = 4;

/// Further capacity of a lane for jobs other than windows, so that a flood of windows does not displace the fault that explains it.
pub const RESERVE: usize = 8;

/// Owner of jobs that are done in order.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Lane {
    /// Daemon: commands, results, telemetry, queries.
    Daemon,
    /// Device, by name.
    Device(Arc<str>),
}

/// Share of its lane that a job may use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LaneLimit {
    /// Share of the lane only.
    Share,
    /// Share and reserve of the lane.
    Reserve,
}

/// Waiting jobs.
#[derive(Debug)]
pub struct StoreQueue<J> {
    /// Lanes that have jobs.
    lanes: BTreeMap<Lane, VecDeque<J>>,
    /// The same lanes in the order of service, the next one first.
    turns: VecDeque<Lane>,
    /// Number of jobs in all devices' lanes.
    device_jobs: usize,
}

impl<J> Default for StoreQueue<J> {
    fn default() -> Self {
        Self {
            lanes: BTreeMap::new(),
            turns: VecDeque::new(),
            device_jobs: 0,
        }
    }
}

impl<J> StoreQueue<J> {
    /// Appends a job to its lane.
    ///
    /// # Errors
    /// The job, if its lane has no room.
    pub fn push(&mut self, lane: &Lane, room: LaneLimit, job: J) -> Result<(), J> {
        if self.lane_len(lane) >= self.limit(lane, room) {
            return Err(job);
        }
        if let Lane::Device(_) = lane {
            self.device_jobs += 1;
        }
        if let Some(jobs) = self.lanes.get_mut(lane) {
            jobs.push_back(job);
        } else {
            self.lanes.insert(lane.clone(), VecDeque::from([job]));
            self.turns.push_back(lane.clone());
        }
        Ok(())
    }

    /// Removes the next job: the first of the next lane.
    pub fn next(&mut self) -> Option<J> {
        let lane = self.turns.pop_front()?;
        let jobs = self.lanes.get_mut(&lane)?;
        let job = jobs.pop_front();
        if jobs.is_empty() {
            self.lanes.remove(&lane);
        } else {
            self.turns.push_back(lane.clone());
        }
        if let Lane::Device(_) = lane {
            self.device_jobs -= 1;
        }
        job
    }

    /// Returns the number of waiting jobs.
    pub fn len(&self) -> usize {
        self.device_jobs + self.lane_len(&Lane::Daemon)
    }

    /// Returns `true` if no job waits.
    pub fn is_empty(&self) -> bool {
        self.turns.is_empty()
    }

    /// Returns the number of waiting jobs in a lane.
    pub fn lane_len(&self, lane: &Lane) -> usize {
        self.lanes.get(lane).map_or(0, VecDeque::len)
    }

    /// Returns the present capacity of a lane.
    fn limit(&self, lane: &Lane, room: LaneLimit) -> usize {
        let reserve = match room {
            LaneLimit::Share => 0,
            LaneLimit::Reserve => RESERVE,
        };
        if *lane == Lane::Daemon {
            return DAEMON + reserve;
        }
        if self.device_jobs >= ALL_DEVICES {
            return GUARANTEED + reserve;
        }
        let others = self.lanes.keys().filter(|other| *other != lane);
        let devices = 1 + others.filter(|other| **other != Lane::Daemon).count();
        (ALL_DEVICES / devices).clamp(GUARANTEED, DEVICE) + reserve
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn device(name: &str) -> Lane {
        Lane::Device(name.into())
    }

    /// Pushes until there is no room. Returns the number of accepted jobs.
    fn flood(queue: &mut StoreQueue<Lane>, lane: &Lane) -> usize {
        (0..10_000)
            .take_while(|_| queue.push(lane, LaneLimit::Share, lane.clone()).is_ok())
            .count()
    }

    #[test]
    fn a_device_that_floods_loses_its_own_windows_and_delays_others_by_one_job() {
        let mut queue = StoreQueue::default();
        let (loud, quiet) = (device("loud"), device("quiet"));
        let mut served = Vec::new();
        let mut lost = 0;
        // The store does one job while the loud device has ten windows, the quiet one has a window each third time.
        for turn in 0..300 {
            for _ in 0..10 {
                lost += usize::from(queue.push(&loud, LaneLimit::Share, loud.clone()).is_err());
            }
            if turn % 3 == 0 {
                let before = queue.lane_len(&quiet);
                assert_eq!(before, 0, "it never waits for a second job of another lane");
                queue.push(&quiet, LaneLimit::Share, quiet.clone()).unwrap();
            }
            served.extend(queue.next());
        }
        assert_eq!(served.iter().filter(|lane| **lane == quiet).count(), 100);
        assert!((DEVICE - 1..=DEVICE).contains(&queue.lane_len(&loud)));
        assert_eq!(lost, 3_000 - 200 - queue.lane_len(&loud));
    }

    #[test]
    fn floods_of_all_devices_leave_room_for_one_more_and_are_bounded() {
        let mut queue = StoreQueue::default();
        for k in 0..100 {
            let taken = flood(&mut queue, &device(&k.to_string()));
            assert!((GUARANTEED..=DEVICE).contains(&taken), "{k}: {taken}");
        }
        assert!(
            queue.len() <= ALL_DEVICES + 100 * GUARANTEED,
            "{}",
            queue.len()
        );
        assert_eq!(flood(&mut queue, &device("late")), GUARANTEED);
        // The daemon's own commands have room, and their turn within one round.
        assert_eq!(flood(&mut queue, &Lane::Daemon), DAEMON);
        let round: Vec<_> = (0..102).filter_map(|_| queue.next()).collect();
        assert_eq!(
            round.iter().filter(|lane| **lane == Lane::Daemon).count(),
            1
        );
        assert_eq!(
            round
                .iter()
                .collect::<std::collections::BTreeSet<_>>()
                .len(),
            102
        );
    }

    #[test]
    fn a_lane_keeps_its_order_and_has_room_for_the_fault_that_explains_a_flood() {
        let mut queue = StoreQueue::default();
        let lane = device("a");
        for k in 0..DEVICE {
            queue.push(&lane, LaneLimit::Share, k).unwrap();
        }
        assert_eq!(queue.push(&lane, LaneLimit::Share, 1_000), Err(1_000));
        queue.push(&lane, LaneLimit::Reserve, 2_000).unwrap();
        let served: Vec<_> = std::iter::from_fn(|| queue.next()).collect();
        let given: Vec<_> = (0..DEVICE).chain([2_000]).collect();
        assert_eq!(served, given);
        assert!(queue.is_empty());
        queue.push(&lane, LaneLimit::Share, 1).unwrap();
        assert_eq!((queue.len(), queue.lane_len(&lane)), (1, 1));
    }
}
