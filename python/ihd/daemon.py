"""Client of a daemon (`ihd trainer --daemon`) over its HTTP API, docs/daemon.md.

Nothing heats without a lease. A lease lasts 10 s; a thread renews it while a `with` block runs. The end of the block,
an exception included, switches the hob off; where the process is killed or the machine goes to sleep nothing renews
the lease, and the hob is off within 10 s.
"""

from __future__ import annotations

import http.client
import itertools
import json
import math
import operator
import os
import socket
import ssl
import threading
import time
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import numpy as np
from numpy.typing import NDArray

_TIMEOUT_S = 25.0
"""Longest wait for an answer; the daemon's own is shorter."""

_SILENCE_S = 45.0
"""Silence after which a stream counts as lost: three heartbeats."""

_RENEW_S = 3.0
"""Period of renewing a lease of 10 s."""

_LOST_S = 8.0
"""Silence of the daemon after which a lease counts as lost; it runs out after 10 s."""

_SHOWN_S = 2.0
"""Time after which a device shows the power that it was asked for."""

_LOOPBACK = {"127.0.0.1", "::1", "localhost"}

Report = dict[str, Any]
"""An answer of the daemon, as `openapi.json` there describes it."""

_leases = itertools.count(1)


class DaemonError(Exception):
    """The daemon refused, or did not answer."""

    def __init__(self, message: str, code: str = "unreachable", status: int | None = None) -> None:
        super().__init__(message)
        self.code = code
        """The API's code, such as "no-device"; "unreachable" without an answer."""
        self.status = status
        """HTTP status; `None` without an answer."""


class LeaseError(DaemonError):
    """Another client holds the lease, or this one has lost it."""


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
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or parts.path.rstrip("/") or parts.query:
            raise ValueError(f"{url}: must be an address like http://127.0.0.1:8731 or https://hob.lan:8731")
        self.url = url.rstrip("/")
        self._host, self._port = parts.hostname, parts.port
        self._token = token if token is not None else os.environ.get("IHD_TOKEN")
        self._tls: ssl.SSLContext | None = None
        if parts.scheme == "https":
            if ca is None:
                raise ValueError("https needs ca=, the file with the daemon's certificate (STORE/tls/certificate.pem)")
            self._tls = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            self._tls.load_verify_locations(os.fspath(ca))
        elif self._token is not None and self._host not in _LOOPBACK:
            raise ValueError(f"{url}: a token goes over https alone")

    def devices(self) -> list[Report]:
        """Reports of all devices."""
        reports: list[Report] = self._get("/devices")
        return reports

    def device(self, name: str) -> Device:
        """A device by its name in the daemon's configuration; nothing is sent yet."""
        return Device(self, name)

    def events(self, device: str | None = None) -> Stream:
        """Events of all devices or one, from now on: "event" has the kind. `{"event": "missed", "missed": n}` says that
        this reader was too slow. Ends with the daemon; raises `DaemonError` where the connection is lost."""
        return self._stream("/events" + ("" if device is None else "?" + urlencode({"device": device})))

    def live(self, interval_s: float = 0.2) -> Stream:
        """The newest: "telemetry" of all "devices" with the extremes since the last one, at most every `interval_s`;
        "devices" with their "reports", every 2 s and at changes; "notice"; "missed"."""
        return self._stream("/live?" + urlencode({"interval_ms": round(interval_s * 1e3)}))

    def _get(self, path: str) -> Any:
        return self._request("GET", path)

    def _request(self, method: str, path: str, body: Report | None = None, holder: str | None = None) -> Any:
        connection, response = self._send(method, path, body, holder, _TIMEOUT_S)
        try:
            return self._answer(response)
        except (OSError, http.client.HTTPException) as why:
            raise self._unreachable(why) from why
        finally:
            connection.close()

    def _send(
        self, method: str, path: str, body: Report | None, holder: str | None, timeout_s: float
    ) -> tuple[http.client.HTTPConnection, http.client.HTTPResponse]:
        connection: http.client.HTTPConnection
        if self._tls is None:
            connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        else:
            connection = http.client.HTTPSConnection(self._host, self._port, timeout=timeout_s, context=self._tls)
        headers = {"content-type": "application/json"} if body is not None else {}
        if holder is not None:
            headers["ihd-holder"] = holder
        if self._token is not None:
            headers["authorization"] = f"Bearer {self._token}"
        try:
            data = None if body is None else json.dumps(body)
            connection.request(method, "/api/v1" + path, data, headers)
            return connection, connection.getresponse()
        except (OSError, http.client.HTTPException) as why:
            connection.close()
            raise self._unreachable(why) from why

    def _answer(self, response: http.client.HTTPResponse) -> Any:
        text = response.read()
        try:
            answer = json.loads(text) if text else None
        except ValueError:
            answer = None
        if 200 <= response.status < 300 and (answer is not None or not text):
            return answer
        if not isinstance(answer, dict) or "message" not in answer:
            raise DaemonError(f"{self.url} is no daemon of ihd: HTTP status {response.status}", "unexpected", response.status)
        code = str(answer.get("error"))
        kind = LeaseError if code == "leased" else DaemonError
        raise kind(str(answer["message"]), code, response.status)

    def _stream(self, path: str) -> Stream:
        # Sent at once, not with the first item: what happens after the call is seen.
        connection, response = self._send("GET", path, None, None, _SILENCE_S)
        if response.status != 200:
            try:
                self._answer(response)
            finally:
                connection.close()
            raise DaemonError(f"{self.url} sends no events", "unexpected", response.status)
        return Stream(self, connection, response)

    def _unreachable(self, why: Exception) -> DaemonError:
        return DaemonError(f"no answer from the daemon at {self.url}: {why}")


class Stream(Iterator[Report]):
    """Server-sent events as an iterator, until the daemon ends or `close`; for a `with` block, too."""

    def __init__(
        self, daemon: Daemon, connection: http.client.HTTPConnection, response: http.client.HTTPResponse
    ) -> None:
        self._daemon = daemon
        self._connection = connection
        self._response = response

    def __next__(self) -> Report:
        try:
            item = self._read()
        except (OSError, http.client.HTTPException, ValueError) as why:
            self.close()
            raise self._daemon._unreachable(why) from why
        if item is None:
            self.close()
            raise StopIteration
        return item

    def _read(self) -> Report | None:
        """The next event; `None` at the end of the stream."""
        kind, data = "", ""
        while line := self._response.readline(1 << 20):
            field, _, value = line.decode().rstrip("\r\n").partition(":")
            value = value.removeprefix(" ")
            if field == "event":
                kind = value
            elif field == "data":
                data += value
            elif not line.strip() and data:
                item = json.loads(data)
                # Of the events of `live`, "devices" is a list of reports.
                item = {"reports": item} if isinstance(item, list) else item
                return {"event": kind, **item} if kind else item
        return None

    def close(self) -> None:
        """Ends the stream."""
        self._response.close()
        self._connection.close()

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        self.close()


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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
        # Dots too: ".." would be another path.
        self._path = "/devices/" + quote(name, safe="-_~").replace(".", "%2E")

    def report(self) -> Report:
        """State, live values, lookup, windows and lease holder."""
        report: Report = self.daemon._get(self._path)
        return report

    def results(self, limit: int = 100) -> list[Report]:
        """Stored results, newest first."""
        results: list[Report] = self.daemon._get(f"{self._path}/results?limit={int(limit)}")
        return results

    def window(self, boot: int | None = None, seq: int | None = None, columns: int = 4000) -> Window:
        """The newest window, or the one of a boot and number."""
        query: dict[str, int] = {"columns": columns}
        if boot is not None and seq is not None:
            query.update(boot=boot, seq=seq)
        scope = self.daemon._get(f"{self._path}/window?{urlencode(query)}")
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
        not kept are left out."""
        kind = "result-stored" if learned else "window-stored"
        return self._windows(self.daemon.events(self.name), kind, columns)

    def _windows(self, events: Iterator[Report], kind: str, columns: int) -> Iterator[Window]:
        for event in events:
            if event.get("event") == kind and event.get("device") == self.name:
                try:
                    window = self.window(event["boot"], event["seq"], columns)
                except DaemonError as error:
                    if error.status == 404:
                        continue
                    raise
                yield window

    def off(self) -> None:
        """Switches the hob off, whoever holds the lease."""
        self._command({"command": "off"}, _holder())

    def lease(self, *, force: bool = False) -> Lease:
        """The right to command the device, for a `with` block; nothing heats by itself."""
        return Lease(self, None, force, None)

    def heat(self, power_w: int, *, at_most_s: float | None = 3600.0, force: bool = False) -> Lease:
        """Heats with a mean power for a `with` block, and for `at_most_s` seconds at most (`None`: without a limit), at
        the end of which the lease is lost. `force` takes the lease from another client, whose hob is switched off first.

            with device.heat(1200) as lease:
                lease.hold(60)
        """
        if at_most_s is not None and not 0 < at_most_s < math.inf:
            raise ValueError(f"at_most_s={at_most_s}: must be a number above zero")
        return Lease(self, operator.index(power_w), force, at_most_s)

    def _command(self, command: Report, holder: str) -> Report:
        reply: Report = self.daemon._request("POST", f"{self._path}/commands", command, holder)
        return reply


class Lease:
    """The right to command a device, for one `with` block. The end of the block switches the hob off."""

    def __init__(self, device: Device, power_w: int | None, force: bool, at_most_s: float | None) -> None:
        self.device = device
        self._power_w = power_w
        self._force = force
        self._at_most_s = at_most_s
        self._holder = _holder()
        self._entered = False
        self._ended = threading.Event()
        self._ending = threading.Lock()
        self._lost: str | None = None
        # Power that was asked for, and when.
        self._asked: tuple[int, float] = (0, 0.0)

    def __enter__(self) -> Lease:
        if self._entered:
            raise RuntimeError("a lease is for one with block: ask for another one")
        self._entered = True
        try:
            self._take(self._force)
        except BaseException:
            # Not off: the hob may heat for another client.
            self._ended.set()
            self._give_back()
            raise
        try:
            self._start_renewal()
            if self._power_w is not None:
                self.power(self._power_w)
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # First: whatever interrupts the rest, nothing renews the lease any more.
        self._ended.set()
        # Not between the end of the time that was given and off.
        with self._ending:
            lost = self._lost
            failed = self._end() if lost is None else None
        # An exception of the block is not hidden by another one.
        if kind is None and lost is not None:
            raise LeaseError(lost, "leased")
        if kind is None and failed is not None:
            raise failed

    @property
    def lost(self) -> str | None:
        """Reason for which the lease was lost; `None` while it is held."""
        return self._lost

    def power(self, power_w: int) -> None:
        """Heats with another mean power; 0 switches off and keeps the lease."""
        power_w = operator.index(power_w)
        self.command({"command": "power", "power_w": power_w})
        self._asked = (power_w, time.monotonic())

    def command(self, command: Report) -> Report:
        """Sends a command of the API, such as {"command": "clear-fault"}."""
        self._check()
        return self.device._command(command, self._holder)

    def hold(self, seconds: float) -> None:
        """Waits; raises `LeaseError` as soon as the lease is lost."""
        self._ended.wait(seconds)
        self._check()

    def _check(self) -> None:
        if self._lost is not None:
            raise LeaseError(self._lost, "leased")
        if self._ended.is_set() or not self._entered:
            raise LeaseError("the lease is held inside of its with block only", "leased")

    def _take(self, force: bool) -> None:
        self.device.daemon._request("PUT", f"{self.device._path}/lease", {"force": force}, self._holder)

    def _start_renewal(self) -> None:
        until = None if self._at_most_s is None else time.monotonic() + self._at_most_s
        # A weak reference: a lease that nobody holds any more is not renewed. The thread ends with the process.
        arguments = (weakref.ref(self), self._ended, until)
        threading.Thread(target=_renew, args=arguments, name=self._holder, daemon=True).start()

    def _renew(self) -> None:
        """Takes the lease again, and looks whether the hob still has its power."""
        self._take(False)
        asked_w, at = self._asked
        if asked_w > 0 and time.monotonic() - at > _SHOWN_S and self.device.report()["asked_by_daemon_w"] == 0:
            raise LeaseError(f"{self.device.name} was switched off elsewhere, or its link was cut", "leased")

    def _run_out(self) -> None:
        """Switches off at the end of the time that was given."""
        with self._ending:
            if not self._ended.is_set():
                self._lost = f"{self.device.name} has had its power for the {self._at_most_s:g} s that it was given"
                self._end()

    def _lose(self, why: str) -> None:
        self._lost = why
        self._ended.set()

    def _end(self) -> DaemonError | None:
        """Switches off and gives the lease back; returns the error if the hob does not confirm that it is off."""
        self._ended.set()
        failed: DaemonError | None = None
        for _ in range(2):
            try:
                self.device._command({"command": "off"}, self._holder)
                failed = None
                break
            except DaemonError as error:
                failed = DaemonError(f"{error}; the hob is off within 10 s by itself", error.code, error.status)
        self._give_back()
        return failed

    def _give_back(self) -> None:
        try:
            self.device.daemon._request("DELETE", f"{self.device._path}/lease", None, self._holder)
        except DaemonError:
            # It was lost, or runs out.
            pass


def _renew(of: weakref.ref[Lease], ended: threading.Event, until: float | None) -> None:
    """Renews a lease until its end. Unanswered requests are repeated for less time than the lease lasts."""
    heard = time.monotonic()
    while not ended.wait(_RENEW_S if until is None else min(_RENEW_S, max(0.0, until - time.monotonic()))):
        lease = of()
        if lease is None:
            return
        now = time.monotonic()
        if until is not None and now >= until:
            return lease._run_out()
        try:
            lease._renew()
            heard = now
        except LeaseError as error:
            # Another client's heating is its own: nothing is switched off.
            lease._lose(str(error))
            return lease._give_back()
        except DaemonError as error:
            if now - heard > _LOST_S:
                return lease._lose(str(error))
        del lease


def _holder() -> str:
    """Name of a client, of its own for each lease: two leases of one name would be one."""
    user = os.environ.get("USER") or os.environ.get("USERNAME") or "somebody"
    name = f"{user}@{socket.gethostname()} python {os.getpid()}.{next(_leases)}"
    printable = "".join(c if c.isascii() and c.isprintable() else "?" for c in name)
    return printable[-64:].strip()
