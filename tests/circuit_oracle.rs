//! The power stage beside ngspice: the same cases as a netlist and in the simulation.
//!
//! tests/circuit-oracle holds ngspice's values; `make_circuit_oracle` writes them.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::Command;

use ihd_firmware::drive::bridge::Bridge;
use ihd_firmware::drive::pwm::DEAD_TIME_NS;
use ihd_shared::hob::{NODE_CAPACITANCE_NF, RESONANCE_CAPACITANCE_NF};
use ihd_sim::behavioural::{BehaviouralLoad, PotKind};
use ihd_sim::inverter::bridge::SwitchedHalfBridge;
use ihd_sim::inverter::bus::Bus;
use ihd_sim::inverter::load::{AmplitudeLaw, LoadState};
use ihd_sim::inverter::supply::SupplyParts;
use ihd_sim::inverter::{Inverter, STEPS_PER_PERIOD, STEPS_PER_SAMPLE};
use ihd_sim::mains::SimulatedMains;

/// Frequency of the mains, in hertz.
const MAINS_HZ: f64 = 50.0;

/// Half-cycles that each case lasts.
const HALF_CYCLES: u32 = 2;

/// Largest step of ngspice, in seconds.
const SPICE_STEP_S: f64 = 20e-9;

/// Power stage with a constant load, from rest at a zero crossing of the mains.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Name in the table.
    pub name: &'static str,
    /// Mains voltage, in volt rms.
    pub mains_v: f64,
    /// Parts between mains and bridge.
    pub supply: SupplyParts,
    /// Load, in ohm.
    pub r_ohm: f64,
    /// Load, in henry.
    pub l_h: f64,
    /// Switching frequency, in hertz.
    pub f_sw_hz: f64,
    /// Time at which both switches open, in seconds; infinite for never.
    pub open_s: f64,
}

/// Quantities of a case that both programs give.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Values {
    /// Largest bus voltage, in volt.
    pub bus_peak_v: f64,
    /// Bus voltage at the end of the first half-cycle, in volt.
    pub bus_crossing_v: f64,
    /// Largest coil current, in ampere.
    pub i_peak_a: f64,
    /// Root mean square of the coil current over the second half-cycle, in ampere.
    pub i_rms_a: f64,
    /// Largest coil voltage, in volt.
    pub coil_peak_v: f64,
    /// Power into the load over the second half-cycle, in watt.
    pub power_w: f64,
}

impl Values {
    /// Names of [`Values::numbers`].
    pub const NAMES: [&'static str; 6] = [
        "bus_peak_v",
        "bus_crossing_v",
        "i_peak_a",
        "i_rms_a",
        "coil_peak_v",
        "power_w",
    ];

    /// All values.
    pub fn numbers(&self) -> [f64; 6] {
        [
            self.bus_peak_v,
            self.bus_crossing_v,
            self.i_peak_a,
            self.i_rms_a,
            self.coil_peak_v,
            self.power_w,
        ]
    }
}

/// Waveform of the bus and of the coil's current: time in seconds, volt, ampere.
pub type Waveform = Vec<(f64, f64, f64)>;

const STEADY: Case = Case {
    name: "",
    mains_v: 230.0,
    supply: SupplyParts::SCHEMATIC,
    r_ohm: 4.0,
    l_h: 24e-6,
    f_sw_hz: 50e3,
    open_s: f64::INFINITY,
};

/// Opening at the crest at a mains of 265 V with the load of the rating, and a line of this inductance.
const fn opened(name: &'static str, line_l_h: f64) -> Case {
    Case {
        name,
        mains_v: 265.0,
        supply: SupplyParts {
            line_l_h,
            ..SupplyParts::SCHEMATIC
        },
        f_sw_hz: 45e3,
        open_s: 5e-3,
        ..STEADY
    }
}

/// Every case.
pub const CASES: [Case; 9] = [
    Case {
        name: "no C2",
        supply: SupplyParts::NONE,
        ..STEADY
    },
    Case {
        name: "C2 4.7 µF, line 0.2 ohm",
        supply: SupplyParts::stiff(4.7e-6),
        ..STEADY
    },
    Case {
        name: "schematic",
        ..STEADY
    },
    Case {
        name: "schematic, C2 1 µF",
        supply: SupplyParts {
            link_capacitance_f: 1e-6,
            ..SupplyParts::SCHEMATIC
        },
        ..STEADY
    },
    Case {
        name: "schematic, small pot at 80 kHz",
        r_ohm: 2.2,
        l_h: 32e-6,
        f_sw_hz: 80e3,
        ..STEADY
    },
    Case {
        name: "schematic, stainless at 80 kHz",
        r_ohm: 0.66,
        l_h: 12.4e-6,
        f_sw_hz: 80e3,
        ..STEADY
    },
    opened("opened at the crest, line 0 mH", 0.0),
    opened("opened at the crest, line 0.2 mH", 0.2e-3),
    opened("opened at the crest, line 0.8 mH", 0.8e-3),
];

impl Case {
    /// Cases that open the bridge.
    pub fn opens(&self) -> bool {
        self.open_s.is_finite()
    }

    fn mains(&self) -> SimulatedMains {
        SimulatedMains::new(MAINS_HZ).changed(0.0, self.mains_v, MAINS_HZ)
    }

    /// Simulates the case; `every` steps are a point of the waveform.
    pub fn simulate(&self, every: usize) -> (Values, Waveform) {
        let load = BehaviouralLoad::new(PotKind::Aluminium, self.f_sw_hz);
        let (r_ohm, l_h) = load.r_l(0.0);
        let mut load = LoadState::law(AmplitudeLaw::Behavioural(load), STEPS_PER_PERIOD);
        load.scale(self.r_ohm / r_ohm, self.l_h / l_h);
        let (dead_s, node_f) = (
            f64::from(DEAD_TIME_NS) * 1e-9,
            f64::from(NODE_CAPACITANCE_NF) * 1e-9,
        );
        let bridge = SwitchedHalfBridge::with_node(dead_s, node_f).expect("the board's");
        let bus = Bus::new(self.mains(), self.supply, 0.0).expect("parts in range");
        let mut inverter = Inverter::new(bus, bridge, load, self.f_sw_hz, STEPS_PER_PERIOD, 0.0);
        let (half_s, mut energy_j, mut square, mut samples) = (0.5 / MAINS_HZ, 0.0, 0.0, 0u32);
        let mut values = Values {
            bus_peak_v: 0.0,
            bus_crossing_v: 0.0,
            i_peak_a: 0.0,
            i_rms_a: 0.0,
            coil_peak_v: 0.0,
            power_w: 0.0,
        };
        let mut waveform = Vec::new();
        let mut step = 0;
        while inverter.now_s() < f64::from(HALF_CYCLES) * half_s {
            let bridge = match inverter.now_s() < self.open_s {
                true => Bridge::Switching,
                false => Bridge::Open,
            };
            let due_s = match inverter.now_s() {
                t if t < half_s => half_s,
                _ => f64::from(HALF_CYCLES) * half_s,
            };
            inverter.run(bridge, STEPS_PER_SAMPLE, |now| {
                values.bus_peak_v = values.bus_peak_v.max(now.bus_v);
                values.i_peak_a = values.i_peak_a.max(now.i_a.abs());
                values.coil_peak_v = values.coil_peak_v.max(now.coil_v.abs());
                if now.t_s < half_s {
                    values.bus_crossing_v = now.bus_v;
                } else {
                    square += now.i_a * now.i_a;
                    samples += 1;
                }
                if step % every == 0 {
                    waveform.push((now.t_s, now.bus_v, now.i_a));
                }
                step += 1;
                let opens = bridge == Bridge::Switching && now.t_s >= self.open_s;
                now.t_s < due_s && !opens
            });
            if due_s == half_s {
                energy_j = inverter.load_energy_j();
            }
        }
        values.i_rms_a = (square / f64::from(samples)).sqrt();
        values.power_w = (inverter.load_energy_j() - energy_j) / half_s;
        (values, waveform)
    }

    /// Netlist of the case for ngspice; `waveform` is a file for bus and coil current.
    pub fn netlist(&self, waveform: Option<&str>) -> String {
        let Self {
            r_ohm,
            l_h,
            f_sw_hz,
            ..
        } = self;
        let s = &self.supply;
        // A snubber across each switch.
        let (dead_s, half_node_nf) = (
            f64::from(DEAD_TIME_NS) * 1e-9,
            0.5 * f64::from(NODE_CAPACITANCE_NF),
        );
        let (period_s, c_r_nf) = (1.0 / f_sw_hz, RESONANCE_CAPACITANCE_NF);
        let (half_s, on_s) = (0.5 * period_s, 0.5 * period_s - dead_s);
        let (end_s, peak_v) = (f64::from(HALF_CYCLES) * 0.5 / MAINS_HZ, self.mains().peak_v);
        let open_s = self.open_s.min(1.0);
        // With a rectifier the mains floats; its voltage and resistance stand behind ideal diodes.
        let minus = if s.link_capacitance_f == 0.0 {
            "0"
        } else {
            "b"
        };
        let mut text = format!(
            "* {}\nVmains e {minus} SIN(0 {peak_v} {MAINS_HZ})\n",
            self.name
        );
        let rectifier = format!(
            "D1 a r dio\nD2 b r dio\nD3 0 a dio\nD4 0 b dio\nRb1 a 0 1e7\nRb2 b 0 1e7\n\
             Rrect r r1 {:e}\nVf r1 dc {}\nC2 dc 0 {:.6e} ic=0\n",
            s.rectifier_r_ohm.max(1e-6),
            s.rectifier_v,
            s.link_capacitance_f
        );
        text += &match (s.link_capacitance_f, s.line_l_h) {
            (0.0, _) => "Bbus dc 0 V=abs(V(e))\n".to_owned(),
            (_, 0.0) => format!("Rline e a {}\n{rectifier}", s.line_r_ohm),
            (_, line_l_h) => format!(
                "Rline e e1 {}\nLline e1 t {line_l_h:.6e}\nC1 t b {:.6e}\nL1 t a {:.6e}\n{rectifier}",
                s.line_r_ohm, s.terminal_capacitance_f, s.choke_l_h
            ),
        };
        if s.discharge_ohm.is_finite() {
            let _ = writeln!(text, "Rbleed dc 0 {:.0}", s.discharge_ohm);
        }
        let _ = write!(
            text,
            "Von on 0 PULSE(1 0 {open_s} 1n 1n 1 2)\n\
             Vup up 0 PULSE(0 1 {dead_s} 1n 1n {on_s} {period_s})\n\
             Vlow low 0 PULSE(0 1 {} 1n 1n {on_s} {period_s})\n\
             Bup gu 0 V=V(up)*V(on)\nBlow gl 0 V=V(low)*V(on)\n\
             Sup dc sw gu 0 sw\nSlow sw 0 gl 0 sw\nDup sw dc dio\nDlow 0 sw dio\nChigh dc sw {half_node_nf}n ic=0\nClow sw 0 {half_node_nf}n ic=0\n\
             Vi sw c1 0\nLcoil c1 c2 {l_h} ic=0\nRcoil c2 x {r_ohm}\nCr x 0 {c_r_nf}n ic=0\n\
             Bpower p 0 V=V(c1,x)*I(Vi)\n\
             .model sw sw(vt=0.5 vh=0 ron=2m roff=1e7)\n.model dio d(is=1e-9 n=0.05 rs=1m cjo=20p)\n\
             .options reltol=1e-4 abstol=1e-6 vntol=1e-4 method=trap\n\
             .tran {SPICE_STEP_S} {end_s} 0 {SPICE_STEP_S} uic\n.control\nrun\nset wr_singlescale\n",
            half_s + dead_s
        );
        let middle_s = 0.5 * end_s;
        let _ = write!(
            text,
            "meas tran bus_peak_v MAX v(dc)\nmeas tran bus_crossing_v FIND v(dc) AT={middle_s}\n\
             let i = abs(i(vi))\nmeas tran i_peak_a MAX i\nmeas tran i_rms_a RMS i from={middle_s} to={end_s}\n\
             let coil = abs(v(c1)-v(x))\nmeas tran coil_peak_v MAX coil\n\
             meas tran power_w AVG v(p) from={middle_s} to={end_s}\n"
        );
        if let Some(file) = waveform {
            let _ = writeln!(text, "wrdata {file} v(dc) i(vi)");
        }
        text + "quit\n.endc\n.end\n"
    }

    /// Runs ngspice on the case.
    ///
    /// # Errors
    /// If it does not run, or a value is missing in its output.
    pub fn ngspice(
        &self,
        folder: &std::path::Path,
    ) -> Result<(Values, Waveform), Box<dyn std::error::Error>> {
        let (netlist, data) = (folder.join("case.cir"), folder.join("waveform"));
        std::fs::write(&netlist, self.netlist(Some(&data.display().to_string())))?;
        let done = Command::new("ngspice").arg("-b").arg(&netlist).output()?;
        let text = String::from_utf8_lossy(&done.stdout);
        let value = |name: &str| {
            let line = text.lines().find(|line| line.starts_with(name));
            let number = line.and_then(|line| {
                line.split('=')
                    .nth(1)?
                    .split_whitespace()
                    .next()?
                    .parse()
                    .ok()
            });
            number.ok_or_else(|| {
                format!(
                    "{}: ngspice gives no {name}:\n{text}\n{}",
                    self.name,
                    String::from_utf8_lossy(&done.stderr)
                )
            })
        };
        let values = Values {
            bus_peak_v: value("bus_peak_v")?,
            bus_crossing_v: value("bus_crossing_v")?,
            i_peak_a: value("i_peak_a")?,
            i_rms_a: value("i_rms_a")?,
            coil_peak_v: value("coil_peak_v")?,
            power_w: value("power_w")?,
        };
        let row = |line: &str| {
            let mut numbers = line.split_whitespace().filter_map(|x| x.parse().ok());
            Some((numbers.next()?, numbers.next()?, numbers.next()?))
        };
        let waveform = std::fs::read_to_string(data)?
            .lines()
            .filter_map(row)
            .collect();
        Ok((values, waveform))
    }
}

/// Folder of the committed values.
pub fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("circuit-oracle")
}
