#!/usr/bin/env python3
"""The same four-state EKF on the same samples in Rust, GNU Octave and NumPy, in one run: prints a table
of times and ratios, and fails when the final states differ.

    host/identify/benches/peers/compare.py [--samples N] [--python PYTHON]

Needs cargo, octave-cli (Debian: octave) and a Python with NumPy; a peer that is missing is left out.
"""

import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[3]
# Octave and NumPy sum in other orders; over many samples that is all that may differ.
TOLERANCE = 1e-6


def measured(command):
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if result.returncode != 0:
        sys.exit(f"{command[0]} failed:\n{result.stderr}")
    return json.loads(result.stdout.strip().splitlines()[-1])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--python", default=sys.executable, help="a Python with NumPy")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        cargo = ["cargo", "run", "--release", "-q", "-p", "ihd-identify"]
        ours = measured([*cargo, "--example", "ekf_peer", "--", folder, str(args.samples)])
        rows = [("ihd, Rust, structured", ours)]
        if shutil.which("octave-cli"):
            octave = measured(["octave-cli", "--norc", str(HERE / "ekf.m"), folder])
            rows.append((f"GNU Octave {octave['version']}, matrices", octave))
        if subprocess.run([args.python, "-c", "import numpy"], capture_output=True).returncode == 0:
            numpy = measured([args.python, str(HERE / "ekf.py"), folder])
            rows.append((f"NumPy {numpy['version']}, matrices", numpy))
    print(f"| four-state EKF, {ours['samples']} samples | time | ns a sample | ratio |")
    print("|---|---:|---:|---:|")
    for name, row in rows:
        ns = row["seconds"] / row["samples"] * 1e9
        ratio = row["seconds"] / ours["seconds"]
        print(f"| {name} | {row['seconds']:.3g} s | {ns:.3g} | {ratio:.4g} |")
    for name, row in rows[1:]:
        worst = max(abs(a - b) / max(abs(b), 1e-3) for a, b in zip(row["x"], ours["x"]))
        print(f"{name}: final state differs by {worst:.1e}", file=sys.stderr)
        if not worst < TOLERANCE:
            sys.exit(f"{name}: another filter than ours")
    if len(rows) == 1:
        sys.exit("no peer found: install octave, or give --python a Python with NumPy")


if __name__ == "__main__":
    main()
