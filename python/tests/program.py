"""The program with which the package is compared, and the fixtures of both."""

import json
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FORMATS = ROOT / "tests/fixtures/formats"
CAPTURES = ROOT / "tests/fixtures/captures"

# Relative difference that results may have from the program's: none, unless the two have different C libraries, whose sines differ in the
# last digit (a release's program has musl's, its wheel the machine's). Of frequency-steps.mcap 3e-8 remains of it.
DIFFERENCE = float(os.environ.get("IHD_DIFFERENCE", "0"))


def ihd(*arguments: object, exits: tuple[int, ...] = (0,)) -> str:
    """Standard output of the program, which ends with one of these exit codes."""
    command = [os.environ["IHD_PROGRAM"], *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    if done.returncode not in exits:
        raise AssertionError(f"{command} ended with {done.returncode}: {done.stderr}")
    return done.stdout


def ihd_json(*arguments: object, exits: tuple[int, ...] = (0,)) -> object:
    """What the program prints with --json."""
    return json.loads(ihd(*arguments, "--json", exits=exits))
