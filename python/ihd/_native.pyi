"""Types of the extension module, python/src; use the package `ihd`."""

import os
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

_Doubles = NDArray[np.float64]

RemarkTuple = tuple[str, Literal["info", "warning", "error"], str, float | None, float | None]

class CaptureError(Exception):
    """A file is no capture, or is damaged; or a channel has to be named."""

class IdentifyError(Exception):
    """A capture holds nothing that can be identified, or the method failed on all of it."""

class StoreError(Exception):
    """A store cannot be opened or read."""

class Capture:
    """Coil voltage and current, sampled together."""

    v: NDArray[np.float32]
    i: NDArray[np.float32]
    t: _Doubles
    fs: float | None
    f_sw: float | None
    f_mains: float | None
    zero_crossing: float | None
    full_scale: tuple[float | None, float | None]
    name: str
    metadata: dict[str, str]
    truth: Sequence[_Doubles] | None
    losses: str | None
    def __len__(self) -> int: ...

class Outcome:
    """Result of a method on a stretch of constant switching frequency."""

    method: str
    f_sw: float
    error: str | None
    t: _Doubles
    R: _Doubles
    L: _Doubles
    sigma_R: _Doubles
    sigma_L: _Doubles
    R_power: _Doubles
    nmse: tuple[float | None, float | None]
    verdict: str
    why: list[str]
    findings: list[RemarkTuple]
    half_cycles: list[tuple[float, float, str, list[str]]]
    notes: list[str]
    law: tuple[_Doubles, _Doubles, _Doubles, _Doubles, _Doubles, float] | None

class Store:
    """Store of a daemon, read-only."""

    devices: list[str]
    def __new__(cls, path: str | os.PathLike[str]) -> Store: ...
    def windows(self, device: str | None = None, since_ms: int | None = None) -> dict[str, Any]: ...
    def results(self, device: str | None = None, since_ms: int | None = None) -> dict[str, Any]: ...
    def events(self, device: str | None = None, since_ms: int | None = None) -> dict[str, Any]: ...
    def telemetry(self, device: str, from_s: int, to_s: int, minutes: bool) -> dict[str, Any]: ...
    def capture(self, device: str, boot: int, seq: int) -> Capture | None: ...

def capture_of(
    v: NDArray[Any], i: NDArray[Any], fs: float, *, t0: float = 0.0, name: str = "arrays"
) -> Capture: ...
def state_of(capture: Capture) -> dict[str, Any]: ...
def restored(state: dict[str, Any]) -> Capture: ...
def read(
    path: str | os.PathLike[str],
    second: str | os.PathLike[str] | None = None,
    *,
    channels: Sequence[int | str] | None = None,
    columns: Sequence[int | str] | None = None,
    units: Sequence[str] | None = None,
    probe: Sequence[float] | None = None,
    invert: str = "",
    swap: bool = False,
    fs: float | None = None,
) -> Capture: ...
def identify(
    capture: Capture,
    methods: Sequence[str],
    settings: str,
    *,
    f_sw: float | None = None,
    f_mains: float | None = None,
    zero_crossing: float | None = None,
    self_calibrate: str = "auto",
    capacitance: float | None = None,
) -> tuple[list[Outcome], list[RemarkTuple]]: ...
def simulate(preset: str, seed: int | None, settings: str) -> Capture: ...
def overall_verdict(verdicts: Sequence[str]) -> str | None:
    """Verdict on the estimates of several stretches together; `None` without one."""

def methods() -> list[str]:
    """Names of all methods of `identify`."""

def presets() -> list[str]:
    """Names of the presets of `simulate`."""
