#!/usr/bin/env python3
"""ihd's estimators and independent peers on the same captures, in one run: errors and processor times.

    pip install -r host/identify/peers/requirements.txt
    cargo build --release -p ihd -p ihd-made-captures --example pot --bin ihd
    python3 host/identify/peers/compare.py --ihd target/release/ihd --pot target/release/examples/pot

Captures: 20 ms at 50 MS/s, 45, 50, 60 and 70 kHz, without noise and at 70, 50 and 30 dB; behavioural load and field
model from `ihd simulate`, and a pot a seed from tests/made-captures, whose circuit and laws of R and L share nothing
with it. Everybody is told the switching and mains frequency, and is held against the same truth at the same times. One
thread on one core. Peers: processor time without the first run, so that compiling does not count (the Kalman filters:
with it). ihd: the least wall-clock time of its estimators in --repeats runs, which is no less than their processor
time. Prints Markdown; docs/accuracy.md has what it printed.
"""

import os

for name in ("OMP", "OPENBLAS", "MKL", "RAYON"):
    os.environ[f"{name}_NUM_THREADS"] = "1"

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict

if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import numpy as np

import capture as captures
import kalman
import lockin
import phasor_pinn
import spline_fit

OURS = {"least-squares": "ihd least-squares", "pinn": "ihd pinn (hybrid)", "lockin": "ihd lockin", "ekf": "ihd ekf"}
# (name, function, whether it takes so long that one run has to do)
PEERS = [
    ("SciPy splines, REML", spline_fit.identify, False),
    ("JAX phasor PINN", phasor_pinn.identify, False),
    ("NumPy lock-in", lockin.identify, False),
    ("filterpy EKF, 4 states", kalman.four_states, True),
    ("filterpy EKF, 3 states", kalman.three_states, True),
]
LOADS = {"behavioural": "Behavioural reference load", "field": "Field model", "pot": "Pots of tests/made-captures"}
KHZ = (45, 50, 60, 70)
SNR_DB = (None, 70, 50, 30)


def measured(args, capture, filters):
    """{name: (errors, seconds)} of everybody on one capture; `filters`: the slow ones too."""
    found = {}
    own = captures.identified(args.ihd, capture, list(OURS), args.repeats)
    for method, (t_s, r, l, seconds) in own.items():
        found[OURS[method]] = (captures.errors_pct(capture, t_s, r, l), seconds)
    for name, identify, slow in PEERS:
        if slow and not filters:
            continue
        kept = capture.path.with_suffix(f".{identify.__module__}.{identify.__name__}.json")
        if not kept.exists():
            kept.write_text(json.dumps(peer(identify, capture, slow)))
        found[name] = json.loads(kept.read_text())
    return found


# Peers that have run once, and so compiled what they compile.
warm = set()


def peer(identify, capture, slow):
    """(errors, seconds) of one peer; unless it is slow, its first run in this process is not timed."""
    if not slow and identify not in warm:
        identify(capture)
        warm.add(identify)
    started = time.process_time()
    estimate = identify(capture)
    seconds = time.process_time() - started
    return captures.errors_pct(capture, *estimate), seconds


def point(args, load, khz, snr_db, folder):
    """Everybody at one operating point: {name: (four errors per seed, mean of the seconds)}."""
    gathered = defaultdict(list)
    # Without noise there is nothing to repeat with one load.
    repeats = snr_db is not None or load == "pot"
    for seed in range(1, 1 + (args.seeds if repeats else 1)):
        case = captures.Case(load, khz, snr_db, seed)
        print(case.stem, file=sys.stderr, flush=True)
        if load == "pot":
            capture = captures.made(args.pot, case, folder)
        else:
            capture = captures.simulated(args.ihd, case, folder)
        for name, (errors, seconds) in measured(args, capture, seed <= args.filter_seeds).items():
            gathered[name].append((np.ravel(errors), seconds))
    return {
        name: (np.array([errors for errors, _ in runs]), np.mean([s for _, s in runs]))
        for name, runs in gathered.items()
    }


def number(x, least):
    text = f"{x:.1f}" if x >= 9.95 else f"{x:.2f}" if x >= 0.995 else f"{x:.3f}".lstrip("0")
    return f"**{text}**" if x <= least else text


def table(points):
    """One load and frequency: a row a method, a column a noise; the least error of a column is bold."""
    names = list(next(iter(points.values())))
    heads = ["noiseless" if snr is None else f"{snr} dB" for snr in points]
    lines = [f"| | {' | '.join(heads)} | ms |", f"|---|{'---:|' * (len(heads) + 1)}"]
    for name in names:
        cells = []
        for found in points.values():
            least = np.min([errors.mean(axis=0) for errors, _ in found.values()], axis=0)
            r, l, middle_r, middle_l = (number(x, y) for x, y in zip(found[name][0].mean(axis=0), least))
            cells.append(f"{r}/{l} · {middle_r}/{middle_l}")
        ms = 1e3 * np.min([found[name][1] for found in points.values()])
        lines.append(f"| {name} | {' | '.join(cells)} | {ms:.3g} |")
    return "\n".join(lines)


def standing(all_points):
    """Who has the least error of R or L over the whole half-cycle, in how many pairs, and by how much."""
    best, beyond = defaultdict(int), defaultdict(int)
    for found in all_points:
        for quantity in (0, 1):
            ranked = sorted(found, key=lambda name: found[name][0][:, quantity].mean())
            best[ranked[0]] += 1
            ours = next(name for name in ranked if name.startswith("ihd"))
            theirs = next(name for name in ranked if not name.startswith("ihd"))
            beyond[apart(found[ours][0][:, quantity], found[theirs][0][:, quantity])] += 1
    words = ", ".join(f"{name} {n}" for name, n in sorted(best.items(), key=lambda b: -b[1]))
    return (
        f"Least error over the whole half-cycle, of {sum(best.values())} pairs of operating point and R or L: {words}. Seed by seed, "
        f"the best estimator of ihd against the best peer: better by more than two standard errors in {beyond[-1]}, worse by more in "
        f"{beyond[1]}, within them in {beyond[0]}; a noiseless capture of a simulated load has no error to count by, and the lesser is "
        "the better."
    )


def apart(ours, theirs):
    """-1, 0 or 1: `ours` is less than, like or more than `theirs` by two standard errors of the paired differences."""
    count = min(len(ours), len(theirs))
    differences = ours[:count] - theirs[:count]
    error = np.std(differences, ddof=1) / np.sqrt(count) if count > 1 else 0.0
    return int(np.sign(differences.mean())) if abs(differences.mean()) > 2 * error else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--ihd", required=True, help="the program, as built by cargo")
    parser.add_argument("--pot", required=True, help="the example of ihd-made-captures, as built by cargo")
    parser.add_argument("--seeds", type=int, default=3, help="seeds of noise, and pots")
    parser.add_argument("--repeats", type=int, default=5, help="runs of ihd, of which the fastest counts")
    parser.add_argument("--folder", help="where captures and what peers made of them are kept, so that it goes on where it was stopped")
    parser.add_argument("--filter-seeds", type=int, default=1, help="of which for the filterpy EKFs, 20 s a capture each")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.folder or temporary
        os.makedirs(folder, exist_ok=True)
        everything = []
        print(
            "R/L in % over the whole half-cycle · over its middle 80 %, mean over "
            f"{args.seeds} seeds of noise or pots (filterpy: {min(args.seeds, args.filter_seeds)}); ms for two half-cycles, least of the columns.\n"
        )
        for load, title in LOADS.items():
            for khz in KHZ:
                points = {snr: point(args, load, khz, snr, folder) for snr in SNR_DB}
                print(f"{title}, {khz} kHz:\n\n{table(points)}\n", flush=True)
                everything += points.values()
        print(standing(everything))


if __name__ == "__main__":
    main()
