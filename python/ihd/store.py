"""A daemon's store, read-only, as columns of numpy arrays."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from .captures import Capture

if TYPE_CHECKING:
    import pandas
    import pyarrow

Time = datetime | np.datetime64 | str
"""Moment; without a zone in UTC, as numpy's are."""


class Columns(dict[str, NDArray[Any]]):
    """Columns of a table by name, each an array of one length; `at` has times in UTC."""

    def to_pandas(self) -> pandas.DataFrame:
        """A pandas frame of the columns; pandas has to be installed."""
        import pandas

        return pandas.DataFrame(dict(self))

    def to_arrow(self) -> pyarrow.Table:
        """An Arrow table of the columns; pyarrow has to be installed."""
        import pyarrow

        return pyarrow.table(dict(self))


class Store:
    """Store of a daemon (`ihd trainer --daemon`). A daemon may write meanwhile; nothing is ever changed here."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Opens the store in a folder; raises `StoreError` if there is none, or if it cannot be read."""
        self._native = _native.Store(path)

    @property
    def devices(self) -> list[str]:
        """Names of the devices."""
        return self._native.devices

    def windows(self, device: str | None = None, since: Time | None = None) -> Columns:
        """Windows of a device, or of all: at, device, boot, seq, half_cycle, f_sw_hz, pairs, not_kept."""
        return _columns(self._native.windows(device, _optional_ms(since)))

    def results(self, device: str | None = None, since: Time | None = None) -> Columns:
        """Results, oldest first: at, device, boot, seq, half_cycle, f_sw_hz, i_crest_a, power_w, r_ohm, l_h,
        sigma_r_pct, sigma_l_pct, passed, why, changed_lookup. R and L are means weighted with i²."""
        return _columns(self._native.results(device, _optional_ms(since)))

    def events(self, device: str | None = None, since: Time | None = None) -> Columns:
        """Events and commands, oldest first: at, device, kind, holder, text, outcome."""
        return _columns(self._native.events(device, _optional_ms(since)))

    def telemetry(
        self, device: str, since: Time = "1970-01-01", until: Time | None = None, *, minutes: bool = True
    ) -> Columns:
        """Telemetry of a device before `until` (default: now), a row for each minute, or each second: at, asked_w, fault, and least, mean and
        largest of power_…_w, i_crest_…_a, r_…_ohm, l_…_h, f_sw_…_hz, as in `power_mean_w`; NaN where it did not heat."""
        end = datetime.now(timezone.utc) + timedelta(seconds=1) if until is None else until
        from_s, to_s = (_ms(time) // 1000 for time in (since, end))
        return _columns(self._native.telemetry(device, from_s, to_s, minutes))

    def capture(self, device: str, boot: int, seq: int) -> Capture:
        """Voltage and current of a window; raises `KeyError` if there is none, or if its samples are not stored."""
        native = self._native.capture(device, boot, seq)
        if native is None:
            raise KeyError(f"no samples of window {seq} of boot {boot} of {device}")
        return Capture._of(native)


def _columns(native: Mapping[str, Any]) -> Columns:
    columns = Columns()
    for name, values in native.items():
        if name == "at":
            columns[name] = values.view("datetime64[ms]")
        elif isinstance(values, list):
            columns[name] = np.array(values, dtype=object)
        else:
            columns[name] = values
    return columns


def _optional_ms(time: Time | None) -> int | None:
    return None if time is None else _ms(time)


def _ms(time: Time) -> int:
    """Milliseconds since 1970."""
    if isinstance(time, datetime) and time.tzinfo is not None:
        time = time.astimezone(timezone.utc).replace(tzinfo=None)
    moment = np.array(time, dtype="datetime64[ms]")
    if np.isnat(moment):
        raise ValueError(f"{time!r} is no time")
    return int(moment.astype(np.int64))
