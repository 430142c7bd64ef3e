//! One run: the pot on the hob, and the temperature estimator.

use ihd_sim::cooking::{Cooking, CookingReport};
use ihd_sim::inverter::InverterError;
use ihd_thermal::{PotEvent, PotReading, ThermalHalfCycle, Thermometer};

use super::{CookingJob, CookingKind, TemperatureRun};

/// Time after a move in seconds within which it must be reported.
const MOVE_REPORT_S: f64 = 3.0;

/// Temperature of the base in °C up to which errors count.
const MAX_C: f64 = 150.0;

/// Truth and estimate, once a second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time in seconds.
    pub t_s: f64,
    /// True rise of the base in kelvin.
    pub rise_k: f64,
    /// Estimate.
    pub estimate: PotReading,
}

fn half_cycle(c: &CookingReport) -> ThermalHalfCycle {
    ThermalHalfCycle {
        t_s: c.t_s,
        f_hz: c.f_hz,
        i_a: c.i_a,
        r_ohm: c.r_ohm,
        l_h: c.l_h,
        power_w: c.power_w,
        heats: c.f_hz > 0.0,
    }
}

/// Power requested by the cook, in watt.
fn asked_w(job: &CookingJob, t_s: f64, base_c: f64) -> f64 {
    let p = job.power_w;
    match job.kind {
        CookingKind::Boil | CookingKind::FoodToRest => p,
        // Once, to between 60 and 100 %.
        CookingKind::BoilInSteps if t_s > 0.25 * job.duration_s => {
            p * (0.6 + 0.4 * super::share(job.seed, 20))
        }
        CookingKind::BoilInSteps => p,
        CookingKind::OilSwitched if base_c > 160.0 => 0.0,
        CookingKind::OilSwitched => p,
        CookingKind::OilHeld => (p - 12.0 * (base_c - 120.0).max(0.0)).max(100.0),
        CookingKind::EmptyHeld => (p - 12.0 * (base_c - 100.0).max(0.0)).max(80.0),
        CookingKind::Simmer if t_s > 120.0 => 150.0,
        CookingKind::Simmer => p,
        CookingKind::Restless => [800.0, p.max(1100.0)][(t_s / 20.0) as usize % 2],
    }
}

/// Puts the job's pot on the hob.
fn put_on(job: &CookingJob) -> Result<Cooking, InverterError> {
    let cooking = Cooking::new(job.pot, job.contents, job.deviation, job.seed)?;
    Ok(cooking.with_noise(job.noise_seed))
}

/// Simulates the cooking; `each` is called with a sample every second.
///
/// # Errors
/// If there is no model of the pot.
pub fn cook(
    job: &CookingJob,
    mut each: impl FnMut(Sample),
) -> Result<TemperatureRun, InverterError> {
    let mut cooking = put_on(job)?;
    let mut thermometer = Thermometer::default();
    for number in 0..job.lessons {
        boil(&job.lesson(number), &mut thermometer)?;
    }
    thermometer.take_events();
    let mut run = TemperatureRun::new(job);
    let (mut move_due, mut next_reading_s) = (job.moved, 0.0);
    while cooking.t_s() < job.duration_s {
        let (t_s, base_c) = (cooking.t_s(), cooking.thermal().temperature_c());
        if let Some((_, to_m)) = move_due.filter(|(at_s, _)| t_s >= *at_s) {
            cooking.set_lift(to_m);
            move_due = None;
        }
        cooking.set_power(asked_w(job, t_s, base_c));
        let cooked = cooking.half_cycle();
        thermometer.push(&half_cycle(&cooked));
        let thermal = cooking.thermal();
        if thermal.bubble_share() > 0.5 {
            run.bubbles_s.get_or_insert(t_s);
        }
        if thermal.is_boiling() {
            run.boils_s.get_or_insert(t_s);
        }
        for event in thermometer.take_events() {
            run.record_event(job, t_s, base_c, event);
        }
        let Some(estimate) = thermometer.reading().filter(|_| t_s >= next_reading_s) else {
            continue;
        };
        next_reading_s = t_s + 1.0;
        let rise_k = base_c - job.pot.temperature_c;
        if base_c <= MAX_C {
            run.record_error(estimate.rise_k - rise_k, estimate.sigma_k);
        }
        each(Sample {
            t_s,
            rise_k,
            estimate,
        });
    }
    Ok(run)
}

/// Cooks before `thermometer`, and takes the pot off.
fn boil(job: &CookingJob, thermometer: &mut Thermometer) -> Result<(), InverterError> {
    let mut cooking = put_on(job)?;
    cooking.set_power(job.power_w);
    while cooking.t_s() < job.duration_s {
        thermometer.push(&half_cycle(&cooking.half_cycle()));
    }
    thermometer.begin_anew();
    Ok(())
}

impl TemperatureRun {
    /// Creates a run of which nothing is known yet.
    fn new(job: &CookingJob) -> Self {
        let moved_m = job.moved.map_or(0.0, |(_, to_m)| to_m - job.pot.lift_m);
        Self {
            seed: job.seed,
            kind: job.kind,
            pot: job.pot.to_string(),
            contents: job.contents.to_string(),
            power_w: job.power_w,
            squares_k2: 0.0,
            readings: 0,
            z_squares: 0.0,
            worst_k: 0.0,
            bubbles_s: None,
            bubbles_reported_s: None,
            boils_s: None,
            boils_reported_s: None,
            moved_mm: 1e3 * moved_m,
            moves_reported: 0,
            moves_wrong: 0,
            overheat_reported_c: None,
        }
    }

    fn record_error(&mut self, off_k: f64, sigma_k: f64) {
        self.squares_k2 += off_k * off_k;
        self.z_squares += (off_k / sigma_k).powi(2);
        self.worst_k = self.worst_k.max(off_k.abs());
        self.readings += 1;
    }

    fn record_event(&mut self, job: &CookingJob, t_s: f64, base_c: f64, event: PotEvent) {
        match event {
            PotEvent::Placed { .. } => {}
            PotEvent::Moved { .. } => {
                let is_due = |(at_s, _): (f64, f64)| (at_s..at_s + MOVE_REPORT_S).contains(&t_s);
                match job.moved.is_some_and(is_due) {
                    true => self.moves_reported += 1,
                    false => self.moves_wrong += 1,
                }
            }
            PotEvent::Bubbles => {
                self.bubbles_reported_s.get_or_insert(t_s);
            }
            PotEvent::Boils { .. } => {
                self.boils_reported_s.get_or_insert(t_s);
            }
            PotEvent::Overheats { .. } => {
                let coldest_c = self.overheat_reported_c.unwrap_or(base_c).min(base_c);
                self.overheat_reported_c = Some(coldest_c);
            }
        }
    }
}
