"""Leases: the right to command a hob, kept by a thread for as long as a `with` block runs."""

from __future__ import annotations

import itertools
import operator
import os
import socket
import threading
import time
import weakref

from .api import Client, DaemonError, LeaseError, Report

_RENEW_S = 3.0
"""Period of renewing a lease of 10 s."""

_ANSWER_S = 5.0
"""Longest wait for the answer to a renewal."""

_LOST_S = 8.0
"""Silence of the daemon after which a lease counts as lost; it runs out after 10 s."""

_SHOWN_S = 2.0
"""Time after which a device shows the power that it was asked for."""

_leases = itertools.count(1)


def send(client: Client, path: str, command: Report, holder: str) -> Report:
    """Sends a command to the device of a path."""
    reply: Report = client.request("POST", f"{path}/commands", command, holder)
    return reply


class Lease:
    """The right to command a device, for one `with` block. The end of the block switches the hob off."""

    def __init__(
        self, client: Client, name: str, path: str, power_w: int | None, force: bool, at_most_s: float | None
    ) -> None:
        self.name = name
        """Name of the device."""
        self._client = client
        self._path = path
        self._power_w = power_w
        self._force = force
        self._at_most_s = at_most_s
        self._holder = holder()
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
        except BaseException as error:
            _note(error, self._end())
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, *_: object) -> None:
        # First: whatever interrupts the rest, nothing renews the lease any more.
        self._ended.set()
        # Not between the end of the time that was given and off.
        with self._ending:
            lost = self._lost
            failed = self._end() if lost is None else None
        # An exception of the block is not hidden by another one.
        if error is not None:
            _note(error, failed)
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
        self.command({"command": "power", "power_w": operator.index(power_w)})

    def command(self, command: Report) -> Report:
        """Sends a command of the API, such as {"command": "clear-fault"}."""
        self._check()
        asked_w = {"off": 0, "power": command.get("power_w")}.get(str(command.get("command")))
        if asked_w == 0:
            # Before the hob is off: a renewal in between must not take it for another client's.
            self._asked = (0, time.monotonic())
        reply = send(self._client, self._path, command, self._holder)
        if asked_w is not None:
            self._asked = (asked_w, time.monotonic())
        return reply

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
        self._client.request("PUT", f"{self._path}/lease", {"force": force}, self._holder, _ANSWER_S)

    def _start_renewal(self) -> None:
        until = None if self._at_most_s is None else time.monotonic() + self._at_most_s
        # A weak reference: a lease that nobody holds any more is not renewed. The thread ends with the process.
        arguments = (weakref.ref(self), self._ended, until)
        threading.Thread(target=_renew, args=arguments, name=self._holder, daemon=True).start()

    def _renew(self) -> None:
        """Takes the lease again, and looks whether the hob still has its power."""
        self._take(False)
        if self._ended.is_set():
            # It was given back meanwhile, and is held again.
            return self._give_back()
        asked_w, at = self._asked
        if asked_w == 0 or time.monotonic() - at <= _SHOWN_S:
            return
        report = self._client.request("GET", self._path, timeout_s=_ANSWER_S)
        # Not if it was asked for another power meanwhile.
        if report["asked_by_daemon_w"] == 0 and self._asked == (asked_w, at):
            raise LeaseError(f"{self.name} was switched off elsewhere, or its link was cut", "leased")

    def _run_out(self) -> None:
        """Switches off at the end of the time that was given."""
        with self._ending:
            if not self._ended.is_set():
                self._lost = f"{self.name} has had its power for the {self._at_most_s:g} s that it was given"
                failed = self._end()
                if failed is not None:
                    self._lost += f"; {failed}"

    def _lose(self, why: str) -> None:
        self._lost = why
        self._ended.set()

    def _end(self) -> DaemonError | None:
        """Switches off and gives the lease back; returns the error if the hob does not confirm that it is off."""
        self._ended.set()
        failed: DaemonError | None = None
        for _ in range(2):
            try:
                send(self._client, self._path, {"command": "off"}, self._holder)
                failed = None
                break
            except DaemonError as error:
                failed = DaemonError(f"{error}; the hob is off within 10 s by itself", error.code, error.status)
        self._give_back()
        return failed

    def _give_back(self) -> None:
        try:
            self._client.request("DELETE", f"{self._path}/lease", None, self._holder)
        except DaemonError:
            # It was lost, or runs out.
            pass


def _note(error: BaseException, failed: DaemonError | None) -> None:
    """Notes at an exception that the hob has not confirmed that it is off; Python 3.10 knows no notes."""
    add = getattr(error, "add_note", None)
    if failed is not None and add is not None:
        add(str(failed))


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
            if time.monotonic() - heard > _LOST_S:
                return lease._lose(str(error))
        except Exception as error:
            # Nobody would renew it any more.
            return lease._lose(f"{type(error).__name__}: {error}")
        del lease


def holder() -> str:
    """Name of a client, of its own for each lease: two leases of one name would be one."""
    user = os.environ.get("USER") or os.environ.get("USERNAME") or "somebody"
    name = f"{user}@{socket.gethostname()} python {os.getpid()}.{next(_leases)}"
    printable = "".join(c if c.isascii() and c.isprintable() else "?" for c in name)
    return printable[-64:].strip()
