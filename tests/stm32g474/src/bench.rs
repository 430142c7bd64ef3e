//! Board on a test bench: the machine in a thread of its own, and the host's end of its serial cable as a [`Transport`] of the
//! host's client. Emulated time passes only while a caller waits, so results do not depend on the load of the computer;
//! [`Bench::run_freely`] lets it pass all the time.

use std::path::Path;
use std::sync::mpsc::{self, Receiver, Sender, TryRecvError};
use std::thread;
use std::time::Duration;

use ihd_link::{LinkError, Transport};
use ihd_sim::plant::Plant;

use crate::image::Image;
use crate::machine::{Machine, MachineError};
use crate::time::{TICKS_PER_S, Ticks, seconds, us};

/// Emulated time between two checks for a job or for sent bytes.
const SLICE: Ticks = us(200);

type Job = Box<dyn FnOnce(&mut Machine, &mut bool) + Send>;

/// Handle of a board that runs in a thread of its own.
#[derive(Clone)]
pub struct Bench {
    jobs: Sender<Job>,
}

impl Bench {
    /// Powers up a board with an image and the power stage that `plant` creates.
    ///
    /// # Errors
    /// The image cannot be read, or the emulator fails.
    pub fn power_up(
        image: &Path,
        plant: impl FnOnce() -> Plant + Send + 'static,
    ) -> Result<Self, MachineError> {
        Self::power_up_with(Image::read(image)?, plant)
    }

    /// Powers up a board with any content of the flash.
    ///
    /// # Errors
    /// The emulator fails.
    pub fn power_up_with(
        image: Image,
        plant: impl FnOnce() -> Plant + Send + 'static,
    ) -> Result<Self, MachineError> {
        let (jobs, inbox) = mpsc::channel::<Job>();
        let (started, result) = mpsc::channel();
        thread::spawn(move || match Machine::with(image, plant()) {
            Ok(machine) => {
                let _ = started.send(Ok(()));
                serve(machine, &inbox);
            }
            Err(error) => {
                let _ = started.send(Err(error));
            }
        });
        result
            .recv()
            .unwrap_or_else(|_| unreachable!("the thread answers before it ends"))?;
        Ok(Self { jobs })
    }

    /// Runs a job on the machine's thread and returns its result.
    ///
    /// # Panics
    /// The machine's thread has ended, which is a defect of the emulator.
    pub fn with<R: Send + 'static>(
        &self,
        job: impl FnOnce(&mut Machine) -> R + Send + 'static,
    ) -> R {
        let (answer, result) = mpsc::channel();
        let job: Job = Box::new(move |machine, _| {
            let _ = answer.send(job(machine));
        });
        self.jobs.send(job).expect("the machine's thread runs");
        result.recv().expect("the machine's thread answers")
    }

    /// Runs the machine for a duration in seconds.
    pub fn run_s(&self, duration_s: f64) {
        let ticks = (duration_s * TICKS_PER_S as f64) as Ticks;
        self.with(move |machine| machine.run_for(ticks).expect("the emulator runs"));
    }

    /// Time since power-on, in seconds.
    pub fn now_s(&self) -> f64 {
        self.with(|machine| seconds(machine.now()))
    }

    /// Lets emulated time pass all the time, or only while a caller waits.
    pub fn run_freely(&self, freely: bool) {
        let job: Job = Box::new(move |_, free| *free = freely);
        let _ = self.jobs.send(job);
    }

    /// Returns the host's end of the serial cable.
    pub fn serial(&self) -> SerialCable {
        SerialCable(self.clone())
    }
}

fn serve(mut machine: Machine, inbox: &Receiver<Job>) {
    let mut free = false;
    loop {
        let job = if free {
            match inbox.try_recv() {
                Ok(job) => Some(job),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => return,
            }
        } else {
            match inbox.recv() {
                Ok(job) => Some(job),
                Err(_) => return,
            }
        };
        match job {
            Some(job) => job(&mut machine, &mut free),
            None => machine.run_for(SLICE).expect("the emulator runs"),
        }
    }
}

/// Host's end of the serial cable.
pub struct SerialCable(Bench);

impl Transport for SerialCable {
    fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let bytes = bytes.to_vec();
        self.0
            .with(move |machine| machine.chip().serial.inbound.extend(bytes));
        Ok(())
    }

    fn receive(&mut self, buf: &mut [u8], timeout: Duration) -> Result<usize, LinkError> {
        let room = buf.len();
        let bytes = self.0.with(move |machine| {
            let deadline = machine.now() + (timeout.as_secs_f64() * TICKS_PER_S as f64) as Ticks;
            while machine.chip().serial.sent.is_empty() && machine.now() < deadline {
                let until = deadline.min(machine.now() + SLICE);
                machine.run_until(until).expect("the emulator runs");
            }
            let sent = &mut machine.chip().serial.sent;
            let n = room.min(sent.len());
            sent.drain(..n).collect::<Vec<_>>()
        });
        buf[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn describe(&self) -> String {
        "serial:emulated".to_owned()
    }

    fn clock(&self) -> Duration {
        Duration::from_secs_f64(self.0.now_s())
    }
}
