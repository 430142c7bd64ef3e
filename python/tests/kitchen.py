"""A daemon with a simulated hob, in a process of its own; one for all tests."""

import atexit
import functools
import os
import socket
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import ihd


@dataclass
class Kitchen:
    url: str
    store: Path
    config: Path

    @property
    def daemon(self) -> ihd.Daemon:
        return ihd.Daemon(self.url)

    @property
    def bench(self) -> ihd.Device:
        return self.daemon.device("bench")

    def is_off_soon(self) -> None:
        """Waits until the hob has no power and nobody holds its lease."""

        def is_off() -> bool:
            report = self.bench.report()
            return report["asked_by_daemon_w"] == 0 and report["lease"] is None

        wait_until(is_off)


@functools.cache
def kitchen() -> Kitchen:
    """Starts the daemon, which ends with this process."""
    return _start("http", "")


@functools.cache
def locked_kitchen() -> Kitchen:
    """Starts a daemon that wants TLS and tokens."""
    return _start("https", 'token_file = "{0}/ihd-tokens"\n[tls]\n')


def _start(scheme: str, keys: str) -> Kitchen:
    folder = tempfile.TemporaryDirectory()
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    root = Path(folder.name)
    config = root / "ihd.toml"
    config.write_text(
        f'store = "{root / "store"}"\nlisten = "127.0.0.1:{port}"\n'
        + keys.format(root)
        + '[[device]]\nname = "bench"\naddress = "sim"\n'
    )
    command = [os.environ["IHD_PROGRAM"], "trainer", "--daemon", "--config", str(config)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    atexit.register(folder.cleanup)
    assert process.stderr is not None
    atexit.register(process.stderr.close)
    atexit.register(process.wait, 60)
    atexit.register(process.terminate)
    log = []
    for line in process.stderr:
        log.append(line)
        if "the daemon listens" in line:
            break
    else:
        raise AssertionError("the daemon ended: " + "".join(log))
    threading.Thread(target=process.stderr.read, daemon=True).start()
    return Kitchen(f"{scheme}://127.0.0.1:{port}", root / "store", config)


def wait_until(happened: Callable[[], bool]) -> None:
    """Asks again and again; minutes end a hang."""
    last = time.monotonic() + 300
    while not happened():
        if time.monotonic() > last:
            raise AssertionError("it never happened")
        time.sleep(0.05)


def learn(windows: int, power_w: int = 1100) -> ihd.Window:
    """Heats until the daemon has learned from so many windows; returns the last one."""
    stream = kitchen().bench.windows(learned=True)
    with kitchen().bench.heat(power_w):
        return [next(stream) for _ in range(windows)][-1]


def wait_for_telemetry() -> None:
    """Waits until the store has a second of telemetry, a few seconds after it was."""
    store = ihd.Store(kitchen().store)
    wait_until(lambda: len(store.telemetry("bench", minutes=False)["at"]) > 0)


def next_event(events, **wanted: object) -> dict:
    """The next event with these values."""
    for event in events:
        if all(event.get(name) == value for name, value in wanted.items()):
            return event
    raise AssertionError(f"the events ended before {wanted}")
