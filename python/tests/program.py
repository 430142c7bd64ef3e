"""The program with which the package is compared, and the fixtures of both."""

import json
import os
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FORMATS = ROOT / "tests/fixtures/formats"
CAPTURES = ROOT / "tests/fixtures/captures"


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
