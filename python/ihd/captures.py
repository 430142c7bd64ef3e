"""Captures: coil voltage and current over time, from files, arrays and the simulation."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from .identification import Identification

Channel = int | str


class CaptureWarning(UserWarning):
    """A part of a file could not be read; the rest was."""


@dataclass(frozen=True, eq=False)
class Truth:
    """True R and L of the fundamental over time, one value per switching period, where there is a current."""

    t: NDArray[np.float64]
    """Time in seconds."""
    R: NDArray[np.float64]
    """Resistance in ohm."""
    L: NDArray[np.float64]
    """Inductance in henry."""
    i: NDArray[np.float64]
    """Amplitude of the current's fundamental in ampere."""


class Capture:
    """Coil voltage `v` in volt and current `i` in ampere, sampled together.

    Samples are float32, as the program holds them: 24 bits, more than any scope gives. `v` and `i` are views of the
    capture's own samples; what is written into them is identified.
    """

    def __init__(self, v: ArrayLike, i: ArrayLike, fs: float, *, t0: float = 0.0, name: str = "arrays") -> None:
        """Makes a capture of arrays with `fs` samples a second, the first at `t0` seconds.

        float64 and float32 arrays are read in place, fields of packed records and other types from a copy.
        """
        self._native = _native.capture_of(_samples(v), _samples(i), fs, t0=t0, name=name)

    @classmethod
    def _of(cls, native: _native.Capture) -> Capture:
        capture = cls.__new__(cls)
        capture._native = native
        return capture

    @property
    def v(self) -> NDArray[np.float32]:
        """Voltage in volt."""
        return self._native.v

    @property
    def i(self) -> NDArray[np.float32]:
        """Current in ampere, positive where positive voltage feeds power into the load."""
        return self._native.i

    @property
    def t(self) -> NDArray[np.float64]:
        """Time of each sample in seconds; a new array at each call."""
        return self._native.t

    @property
    def fs(self) -> float | None:
        """Samples a second; `None` where they are not evenly spaced."""
        return self._native.fs

    @property
    def f_sw(self) -> float | None:
        """Switching frequency that the file states, in hertz; `None` if it states none or several."""
        return self._native.f_sw

    @property
    def f_mains(self) -> float | None:
        """Mains frequency that the file states, in hertz."""
        return self._native.f_mains

    @property
    def zero_crossing(self) -> float | None:
        """Time of a mains zero crossing that the file states, in seconds."""
        return self._native.zero_crossing

    @property
    def full_scale(self) -> tuple[float | None, float | None]:
        """Magnitudes in volt and ampere beyond which the channels clip, where the file states them."""
        return self._native.full_scale

    @property
    def name(self) -> str:
        """Path of the file, or a description."""
        return self._native.name

    @property
    def metadata(self) -> dict[str, str]:
        """Further information in the file."""
        return self._native.metadata

    @property
    def truth(self) -> Truth | None:
        """True R(t) and L(t) of a simulation; `None` for a measured capture."""
        truth = self._native.truth
        return None if truth is None else Truth(*truth)

    @property
    def losses(self) -> str | None:
        """Losses of a damaged file; `None` for a whole one."""
        return self._native.losses

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (_native.state_of(self._native),)

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return repr(self._native)

    def identify(
        self,
        method: str = "least-squares",
        *,
        f_sw: float | None = None,
        f_mains: float | None = None,
        zero_crossing: float | None = None,
        preset: str | None = None,
        deterministic: bool = False,
        settings: Mapping[str, Any] | None = None,
        self_calibrate: Literal["auto", "report", "off"] = "auto",
        capacitance: float | None = None,
    ) -> Identification:
        """Identifies R(t) and L(t), as `ihd identify` does, and judges the result.

        `method` is one of `ihd.methods()`. `f_sw`, `f_mains` (Hz) and `zero_crossing` (s) replace what the capture shows. `preset` and `deterministic`
        are the network's, of method "pinn"; without `deterministic` a limit of time may change its last digits.
        `settings` are the estimators' own, as in the file of `ihd identify --settings`. `self_calibrate` and
        `capacitance` (F, of the resonance) are for the sensors.

        Raises `IdentifyError` where nothing can be identified, and `ValueError` for a wrong option. A refused result
        is returned: look at `verdict`.
        """
        if method != "pinn" and (preset is not None or deterministic):
            raise ValueError('preset and deterministic are for method="pinn"')
        options = dict(settings or {})
        network = dict(options.get("pinn", {}))
        if preset is not None:
            network["preset"] = preset
        if deterministic:
            network["deterministic"] = True
        if network:
            options["pinn"] = network
        outcomes, remarks = _native.identify(
            self._native,
            [method],
            json.dumps(options, allow_nan=False),
            f_sw=f_sw,
            f_mains=f_mains,
            zero_crossing=zero_crossing,
            self_calibrate=self_calibrate,
            capacitance=capacitance,
        )
        return Identification._of(outcomes, remarks)


def _restored(state: dict[str, Any]) -> Capture:
    return Capture._of(_native.restored(state))


def _samples(x: ArrayLike) -> NDArray[Any]:
    array = np.asanyarray(x)
    if array.dtype.kind not in "fiu":
        raise TypeError(f"samples must be numbers: {array.dtype} are none")
    if array.dtype not in (np.float64, np.float32):
        array = array.astype(np.float64)
    array = array.filled(np.nan) if isinstance(array, np.ma.MaskedArray) else np.asarray(array)
    # A field of packed records: the extension counts strides in whole samples.
    packed = not array.flags.aligned or any(stride % array.itemsize for stride in array.strides)
    return array.copy() if packed else array


def identify(v: ArrayLike, i: ArrayLike, fs: float, method: str = "least-squares", **options: Any) -> Identification:
    """Identifies R(t) and L(t) from coil voltage in volt and current in ampere; options as `Capture.identify`."""
    return Capture(v, i, fs).identify(method, **options)


def read(
    path: str | os.PathLike[str],
    second: str | os.PathLike[str] | None = None,
    *,
    channels: Sequence[Channel] | None = None,
    columns: Sequence[Channel] | None = None,
    units: Sequence[str] | None = None,
    probe: Sequence[float] | None = None,
    invert: str = "",
    swap: bool = False,
    fs: float | None = None,
) -> Capture:
    """Reads a capture: MCAP, CSV, Tektronix WFM or ISF, LeCroy TRC, MATLAB v5 or NPZ; the content decides.

    The options are those of `ihd identify --input`: `channels` (voltage, current) and `columns` of a table (time or
    "-", voltage, current) by number from 1 or by name; `units` as in ("mV", "A"); `probe`, the ratio of the voltage
    probe and the ampere per volt of the current probe; `invert` "v", "i" or "vi"; `swap`; `fs`, the sampling rate.
    `second` is the file of the same acquisition with the other channel.

    A damaged file gives what could be read, with a `CaptureWarning`. Raises `CaptureError` where that is nothing.
    """
    native = _native.read(
        path,
        second,
        channels=channels,
        columns=columns,
        units=units,
        probe=probe,
        invert=invert,
        swap=swap,
        fs=fs,
    )
    if native.losses is not None:
        warnings.warn(f"{native.name}: {native.losses}", CaptureWarning, stacklevel=2)
    return Capture._of(native)


def simulate(preset: str = "paper-45", seed: int | None = None, settings: Mapping[str, Any] | None = None) -> Capture:
    """Simulates coil voltage and current of a hob, with the truth about R(t) and L(t).

    `presets()` has the names of the presets. `settings` are values over a preset's, by the names that the metadata
    `simulation` of a simulated capture has, as {"duration_s": 0.02, "sensing": {"snr_db": 30}}; an unknown one is a
    `ValueError` that lists all.
    """
    return Capture._of(_native.simulate(preset, seed, json.dumps(dict(settings or {}), allow_nan=False)))
