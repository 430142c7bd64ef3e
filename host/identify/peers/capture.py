"""Captures with truth from `ihd simulate`, and the paper's mean relative error on them."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# Current amplitude, as a share of the largest, below which the truth's own R and L are rounding.
MIN_CURRENT = 1e-3
# The paper drops the first half-cycle, in which filters settle.
FROM_S = 0.01
# Exit code of `ihd identify` when its gate refuses a result; the estimates are there all the same.
GATE_REFUSES = 7


@dataclass(frozen=True)
class Case:
    """One capture of 20 ms at 50 MS/s: the paper's operating point, or a pot of tests/made-captures, another one each seed."""

    load: str
    khz: int
    snr_db: int | None
    seed: int

    @property
    def stem(self):
        return f"{self.load}-{self.khz}-{self.snr_db or 'clean'}-{self.seed}"


@dataclass
class Capture:
    """Samples in volt and ampere, and R and L of the fundamental in ohm and henry, period by period."""

    path: Path
    t_s: np.ndarray
    v_v: np.ndarray
    i_a: np.ndarray
    f_sw_hz: float
    mains_hz: float
    truth_t_s: np.ndarray
    truth_r_ohm: np.ndarray
    truth_l_h: np.ndarray

    @property
    def dt_s(self):
        return (self.t_s[-1] - self.t_s[0]) / (len(self.t_s) - 1)

    def half_cycles(self):
        """(first, end) sample of each whole mains half-cycle; time counts from a zero crossing."""
        per_half = 0.5 / self.mains_hz / self.dt_s
        halves = int(round(len(self.t_s) / per_half))
        edges = [min(round(k * per_half), len(self.t_s)) for k in range(halves + 1)]
        return list(zip(edges[:-1], edges[1:]))


def made(program, case, folder):
    """Has tests/made-captures' example write a case into `folder`, unless it is there, and reads it."""
    table = Path(folder) / f"{case.stem}.npz"
    if not table.exists():
        snr = "inf" if case.snr_db is None else str(case.snr_db)
        subprocess.run([program, str(case.khz), snr, str(case.seed), str(table)], check=True)
    return read(table, table)


def simulated(ihd, case, folder):
    """Simulates a case into `folder`, unless it is there, and reads it."""
    recording = Path(folder) / f"{case.stem}.mcap"
    table = recording.with_suffix(".npz")
    if not table.exists():
        command = [ihd, "simulate", f"paper-{case.khz}", "--set", f"load={case.load},rate=50M"]
        command += ["--seed", str(case.seed), "--out", str(recording)]
        if case.snr_db is not None:
            command += ["--set", f"snr={case.snr_db}"]
        for step in (command, [ihd, "convert", str(recording), "--out", str(table)]):
            subprocess.run(step, check=True, stdout=subprocess.DEVNULL)
    return read(recording, table)


def read(recording, table):
    with np.load(table) as file:
        i_a = file["truth_i_a"]
        known = i_a > MIN_CURRENT * i_a.max()
        samples = len(file["v_V"])
        return Capture(
            path=recording,
            t_s=float(file["t0_s"]) + float(file["dt_s"]) * np.arange(samples),
            v_v=file["v_V"].astype(np.float64),
            i_a=file["i_A"].astype(np.float64),
            f_sw_hz=float(file["f_sw_hz"][0]),
            mains_hz=float(file["mains_hz"]),
            truth_t_s=file["truth_t_s"][known],
            truth_r_ohm=file["truth_r_ohm"][known, 0],
            truth_l_h=file["truth_l_h"][known, 0],
        )


def errors_pct(capture, t_s, r_ohm, l_h):
    """MRE of R and L over the last half-cycle, and over its middle 80 %: ((R, L), (R, L)) in percent.

    At the truth's times; the estimate is taken as linear between its points and as held outside. It is
    what `ihd identify --from 10ms` prints (`ihd_identify::accuracy`).
    """
    own = t_s >= FROM_S
    at = capture.truth_t_s >= FROM_S
    times = capture.truth_t_s[at]
    half_s = 0.5 / capture.mains_hz
    middle = np.abs((times % half_s) / half_s - 0.5) <= 0.4
    pairs = [(r_ohm, capture.truth_r_ohm), (l_h, capture.truth_l_h)]
    relative = [
        100 * np.abs(np.interp(times, t_s[own], found[own]) / right[at] - 1)
        for found, right in pairs
    ]
    whole = tuple(float(e.mean()) for e in relative)
    return whole, tuple(float(e[middle].mean()) for e in relative)


def identified(ihd, capture, methods, repeats):
    """R and L of `ihd identify`: {method: (t_s, r_ohm, l_h, seconds)}; the least time of `repeats` runs.

    The seconds are the estimator's own, wall clock on one thread: no less than its processor time.
    """
    command = [ihd, "identify", str(capture.path), "--method", ",".join(methods), "--json"]
    command += ["--input", f"fsw={capture.f_sw_hz!r},mains={capture.mains_hz!r}"]
    command += ["--from", str(FROM_S), "--network", "deterministic"]
    found = {}
    for _ in range(repeats):
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == GATE_REFUSES:
            print(f"{capture.path.stem}: ihd's gate refuses a result", file=sys.stderr)
        elif done.returncode != 0:
            sys.exit(f"{' '.join(command)}:\n{done.stderr}")
        for entry in json.loads(done.stdout):
            seconds = entry["elapsed_s"]
            before = found.get(entry["method"])
            if before is None or seconds < before[3]:
                columns = [np.array(entry[key]) for key in ("t_s", "r_ohm", "l_h")]
                found[entry["method"]] = (*columns, seconds)
    return found
