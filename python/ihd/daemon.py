"""Client of a daemon (`ihd trainer --daemon`) over its HTTP API, docs/daemon.md.

Nothing heats without a lease. A lease lasts 10 s; a thread renews it while a `with` block runs. The end of the block,
an exception included, switches the hob off; where the process is killed or the machine goes to sleep nothing renews
the lease, and the hob is off within 10 s.
"""

from __future__ import annotations

import math
import operator
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from urllib.parse import quote, urlencode

import numpy as np
from numpy.typing import NDArray

from .api import Client, DaemonError, Report, Stream
from .lease import Lease, holder, send


class Daemon:
    """A daemon at a URL."""

    def __init__(
        self,
        url: str = "http://127.0.0.1:8731",
        *,
        token: str | None = None,
        ca: str | os.PathLike[str] | None = None,
    ) -> None:
        """Sends nothing yet. `token` is the role's of the token file, or that of the environment's IHD_TOKEN; `ca` the
        only certificate that is trusted with https, the daemon's own (STORE/tls/certificate.pem)."""
        self._client = Client(url, token, ca)
        self.url = self._client.url

    def devices(self) -> list[Report]:
        """Reports of all devices."""
        reports: list[Report] = self._client.get("/devices")
        return reports

    def device(self, name: str) -> Device:
        """A device by its name in the daemon's configuration; nothing is sent yet."""
        return Device(self, name)

    def events(self, device: str | None = None) -> Stream:
        """Events of all devices or one, from now on: "event" has the kind. `{"event": "missed", "missed": n}` says that
        this reader was too slow. Ends with the daemon; raises `DaemonError` where the connection is lost."""
        return self._client.stream("/events" + ("" if device is None else "?" + urlencode({"device": device})))

    def live(self, interval_s: float = 0.2) -> Stream:
        """The newest: "telemetry" of all "devices" with the extremes since the last one, at most every `interval_s`;
        "devices" with their "reports", every 2 s and at changes; "notice"; "missed"."""
        return self._client.stream("/live?" + urlencode({"interval_ms": round(interval_s * 1e3)}))


@dataclass(frozen=True, eq=False)
class Curve:
    """R(t) and L(t) of a window: time in seconds after its first sample, ohm, henry; empty σ where none is known."""

    t: NDArray[np.float64]
    R: NDArray[np.float64]
    L: NDArray[np.float64]
    sigma_R: NDArray[np.float64]
    sigma_L: NDArray[np.float64]

    @classmethod
    def _of(cls, report: Report | None) -> Curve | None:
        names = ("t_s", "r_ohm", "l_h", "r_sigma_ohm", "l_sigma_h")
        return None if report is None else cls(*(np.array(report[name], dtype=float) for name in names))


@dataclass(frozen=True, eq=False)
class Window:
    """Window of a half-cycle in columns of a display: least and largest voltage and current of each. All samples of it
    are in the store: `Store.capture(device, boot, seq)`."""

    device: str
    boot: int
    seq: int
    f_sw: float
    """Switching frequency in hertz."""
    t: NDArray[np.float64]
    """Middle of each column in seconds after the first sample."""
    v_min: NDArray[np.float64]
    v_max: NDArray[np.float64]
    i_min: NDArray[np.float64]
    i_max: NDArray[np.float64]
    filter: Curve | None
    """The device's own estimate, by its Kalman filter."""
    network: Curve | None
    """The network's; `None` before it has identified the window."""
    truth: Curve | None
    """`None` unless the device is simulated in the daemon."""
    passed: bool | None
    """Verdict on the network's result; `None` without one."""
    why: str
    """Reason of a refusal."""


class Device:
    """A device of a daemon."""

    def __init__(self, daemon: Daemon, name: str) -> None:
        self.daemon = daemon
        self.name = name
        self._client = daemon._client
        # Dots too: ".." would be another path.
        self._path = "/devices/" + quote(name, safe="-_~").replace(".", "%2E")

    def report(self) -> Report:
        """State, live values, lookup, windows and lease holder."""
        report: Report = self._client.get(self._path)
        return report

    def results(self, limit: int = 100) -> list[Report]:
        """Stored results, newest first."""
        results: list[Report] = self._client.get(f"{self._path}/results?limit={int(limit)}")
        return results

    def window(self, boot: int | None = None, seq: int | None = None, columns: int = 4000) -> Window:
        """The newest window, or the one of a boot and number."""
        if (boot is None) != (seq is None):
            raise ValueError("boot and seq: give both, or none")
        query: dict[str, int] = {"columns": columns}
        if boot is not None and seq is not None:
            query.update(boot=boot, seq=seq)
        scope = self._client.get(f"{self._path}/window?{urlencode(query)}")
        t, v_min, v_max, i_min, i_max = (
            np.array(scope[name], dtype=float) for name in ("t_s", "v_min_v", "v_max_v", "i_min_a", "i_max_a")
        )
        return Window(
            device=self.name,
            boot=scope["boot"],
            seq=scope["seq"],
            f_sw=float(scope["f_sw_hz"]),
            t=t,
            v_min=v_min,
            v_max=v_max,
            i_min=i_min,
            i_max=i_max,
            filter=Curve._of(scope["ekf"]),
            network=Curve._of(scope["network"]),
            truth=Curve._of(scope["truth"]),
            passed=scope["pass"],
            why=scope["why"],
        )

    def windows(self, *, learned: bool = False, columns: int = 4000) -> Iterator[Window]:
        """Windows from now on, each when it is stored, or when the network has learned from it. Those whose samples are
        not kept are left out. Warns (`RuntimeWarning`) of events that this reader was too slow for."""
        kind = "result-stored" if learned else "window-stored"
        return self._windows(self.daemon.events(self.name), kind, columns)

    def _windows(self, events: Iterator[Report], kind: str, columns: int) -> Iterator[Window]:
        for event in events:
            if event.get("event") == "missed":
                warnings.warn(f"{self.name}: {event['missed']} events were missed, windows among them", RuntimeWarning, stacklevel=2)
            if event.get("event") == kind and event.get("device") == self.name:
                try:
                    window = self.window(event["boot"], event["seq"], columns)
                except DaemonError as error:
                    if error.code == "no-window":
                        continue
                    raise
                yield window

    def off(self) -> None:
        """Switches the hob off, whoever holds the lease."""
        send(self._client, self._path, {"command": "off"}, holder())

    def lease(self, *, force: bool = False) -> Lease:
        """The right to command the device, for a `with` block; nothing heats by itself."""
        return Lease(self._client, self.name, self._path, None, force, None)

    def heat(self, power_w: int, *, at_most_s: float | None = 3600.0, force: bool = False) -> Lease:
        """Heats with a mean power for a `with` block, and for `at_most_s` seconds at most (`None`: without a limit), at
        the end of which the lease is lost. `force` takes the lease from another client, whose hob is switched off first.

            with device.heat(1200) as lease:
                lease.hold(60)
        """
        if at_most_s is not None and not 0 < at_most_s < math.inf:
            raise ValueError(f"at_most_s={at_most_s}: must be a number above zero")
        return Lease(self._client, self.name, self._path, operator.index(power_w), force, at_most_s)
