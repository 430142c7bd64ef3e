"""Client of the daemon: windows while a hob heats, and leases that end whatever happens."""

import gc
import http.server
import signal
import subprocess
import sys
import threading
import unittest

import ihd
import numpy as np
from kitchen import kitchen, locked_kitchen, next_event

# Heats and says so, then waits for its end.
HEATS = """
import sys, time, ihd
with ihd.Daemon(sys.argv[1]).device("bench").heat(1000) as lease:
    print("heats", flush=True)
    time.sleep(600)
"""


class Windows(unittest.TestCase):
    def test_windows_and_results_come_while_it_heats(self) -> None:
        bench = kitchen().bench
        self.assertIn("bench", [report["name"] for report in kitchen().daemon.devices()])
        windows = bench.windows(learned=True)
        with bench.heat(1200) as lease:
            first, second = next(windows), next(windows)
            lease.power(800)
        self.assertLess(first.seq, second.seq)
        for window in (first, second):
            assert window.network is not None and window.truth is not None
            self.assertEqual(len(window.t), len(window.v_max))
            self.assertTrue(np.all(window.v_min <= window.v_max))
            # In the middle of the half-cycle the network is near the simulation's truth.
            middle = slice(len(window.network.t) // 3, -len(window.network.t) // 3)
            true = np.interp(window.network.t[middle], window.truth.t, window.truth.R)
            np.testing.assert_allclose(window.network.R[middle], true, rtol=0.05)
        self.assertEqual(bench.results(limit=1)[0]["device"], "bench")
        for half in ({"boot": first.boot}, {"seq": first.seq}):
            with self.assertRaisesRegex(ValueError, "give both"):
                bench.window(**half)
        self.assertNotEqual(first, second)
        self.assertEqual(len({first, second, first}), 2)
        self.assertEqual(bench.report()["asked_by_daemon_w"], 0)

    def test_telemetry_is_live(self) -> None:
        bench = kitchen().bench
        reports = 0
        with bench.heat(900), kitchen().daemon.live(0.1) as items:
            for item in items:
                if item["event"] == "devices":
                    reports += len(item["reports"])
                # A device that said nothing in this interval is not among them.
                elif item["event"] == "telemetry" and "bench" in item["devices"] and reports:
                    if item["devices"]["bench"]["power_w"][1] > 100:
                        break


class Leases(unittest.TestCase):
    def setUp(self) -> None:
        self.bench = kitchen().bench
        self.events = kitchen().daemon.events("bench")
        self.addCleanup(self.events.close)

    def is_off(self) -> None:
        report = self.bench.report()
        self.assertEqual(report["asked_by_daemon_w"], 0)
        self.assertIsNone(report["lease"])

    def test_the_end_of_the_block_switches_off(self) -> None:
        with self.bench.heat(1000) as lease:
            self.assertEqual(self.bench.report()["asked_by_daemon_w"], 1000)
            self.assertIsNotNone(self.bench.report()["lease"])
        self.is_off()
        with self.assertRaises(ihd.LeaseError):
            lease.power(500)
        with self.assertRaises(RuntimeError), lease:
            pass

    def test_an_exception_in_the_block_switches_off_and_goes_on(self) -> None:
        for error in (ZeroDivisionError, KeyboardInterrupt):
            with self.assertRaises(error), self.bench.heat(1000):
                raise error
            self.is_off()

    def test_asking_for_heat_alone_heats_nothing(self) -> None:
        self.bench.heat(1000)
        self.is_off()
        with self.bench.lease():
            self.assertEqual(self.bench.report()["asked_by_daemon_w"], 0)
        self.is_off()

    def test_a_second_client_is_refused_and_the_first_heats_on(self) -> None:
        with self.bench.heat(1000):
            with self.assertRaisesRegex(ihd.LeaseError, "commands bench"), self.bench.heat(2000):
                self.fail("heats without a lease")
            self.assertEqual(self.bench.report()["asked_by_daemon_w"], 1000)
        self.is_off()

    def test_a_lease_taken_by_force_is_lost_and_the_others_heating_is_left_alone(self) -> None:
        with self.assertRaisesRegex(ihd.LeaseError, "commands bench"):
            with self.bench.heat(1000) as lease:
                with self.bench.heat(700, force=True):
                    with self.assertRaises(ihd.LeaseError):
                        lease.hold(600)
                    self.assertIsNotNone(lease.lost)
                    self.assertEqual(self.bench.report()["asked_by_daemon_w"], 700)
        self.is_off()

    def test_off_elsewhere_is_noticed(self) -> None:
        with self.assertRaisesRegex(ihd.LeaseError, "elsewhere|commands"):
            with self.bench.heat(1000) as lease:
                self.bench.off()
                lease.hold(600)
        kitchen().is_off_soon()

    def test_the_time_given_ends_it(self) -> None:
        with self.assertRaisesRegex(ihd.LeaseError, "0.5 s that it was given"):
            with self.bench.heat(1000, at_most_s=0.5) as lease:
                lease.hold(600)
        self.is_off()

    def test_a_killed_process_leaves_a_lease_that_runs_out(self) -> None:
        command = [sys.executable, "-c", HEATS, kitchen().url]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            self.assertEqual(process.stdout.readline(), "heats\n")
            process.send_signal(signal.SIGKILL)
        event = next_event(self.events, event="lease", holder="")
        self.assertTrue(event["why"])
        kitchen().is_off_soon()

    def test_a_lease_that_nobody_holds_any_more_runs_out(self) -> None:
        self.bench.heat(1000).__enter__()
        gc.collect()
        self.assertTrue(next_event(self.events, event="lease", holder="")["why"])
        kitchen().is_off_soon()

    def test_a_wrong_power_or_time_takes_no_lease(self) -> None:
        for power_w in (1000.5, "1000", None):
            with self.subTest(power_w=power_w), self.assertRaises(TypeError):
                self.bench.heat(power_w)
        for at_most_s in (0, -1, float("nan"), float("inf")):
            with self.subTest(at_most_s=at_most_s), self.assertRaises(ValueError):
                self.bench.heat(1000, at_most_s=at_most_s)
        with self.bench.heat(np.int64(1000)):
            self.assertEqual(self.bench.report()["asked_by_daemon_w"], 1000)
        self.is_off()

    def test_what_the_device_refuses_leaves_no_lease(self) -> None:
        with self.assertRaises(ihd.DaemonError), self.bench.heat(60_000):
            self.fail("heats with 60 kW")
        self.is_off()


class Errors(unittest.TestCase):
    def test_errors_name_the_cause(self) -> None:
        with self.assertRaises(ihd.DaemonError) as caught:
            kitchen().daemon.device("none").report()
        self.assertEqual((caught.exception.code, caught.exception.status), ("no-device", 404))
        with self.assertRaises(ihd.DaemonError), kitchen().daemon.device("../x").heat(1000):
            self.fail("heats")
        with self.assertRaisesRegex(ihd.DaemonError, "127.0.0.1:1"):
            ihd.Daemon("http://127.0.0.1:1").devices()

    def test_tokens_go_over_tls_alone(self) -> None:
        with self.assertRaisesRegex(ValueError, "https alone"):
            ihd.Daemon("http://hob.lan:8731", token="secret")
        with self.assertRaisesRegex(ValueError, "ca="):
            ihd.Daemon("https://hob.lan:8731")
        for url in ["hob.lan", "ftp://hob.lan", "http://", "http://hob.lan/api/v1"]:
            with self.subTest(url=url), self.assertRaises(ValueError):
                ihd.Daemon(url)

    def test_over_tls_a_role_is_what_its_token_gives(self) -> None:
        locked = locked_kitchen()
        ca = locked.store / "tls/certificate.pem"
        lines = (locked.store.parent / "ihd-tokens").read_text().splitlines()
        tokens = dict(line.split() for line in lines if line and not line.startswith("#"))

        def bench(token: str | None) -> ihd.Device:
            return ihd.Daemon(locked.url, token=token, ca=ca).device("bench")

        self.assertEqual(bench(tokens["read"]).report()["name"], "bench")
        with bench(tokens["operate"]).heat(1000):
            self.assertEqual(bench(tokens["read"]).report()["asked_by_daemon_w"], 1000)
        for token in (tokens["read"], "wrong", None):
            with self.subTest(token=token), self.assertRaises(ihd.DaemonError) as caught:
                with bench(token).heat(1000):
                    self.fail("heats")
            self.assertIn(caught.exception.status, (401, 403))
        # The certificate is not for this address.
        with self.assertRaises(ihd.DaemonError):
            ihd.Daemon(locked.url.replace("127.0.0.1", "127.0.0.2"), token=tokens["read"], ca=ca).devices()

    def test_another_server_is_no_daemon(self) -> None:
        for body in [b"<html>", b"[1]", b"", b"{}"]:
            with self.subTest(body=body), Server(500, body) as url:
                with self.assertRaisesRegex(ihd.DaemonError, "no daemon of ihd"):
                    ihd.Daemon(url).devices()
        with Server(200, b"<html>") as url, self.assertRaisesRegex(ihd.DaemonError, "no daemon of ihd"):
            ihd.Daemon(url).devices()

    def test_the_token_is_sent_and_redirects_are_not_followed(self) -> None:
        with Server(302, b"{}") as url:
            with self.assertRaises(ihd.DaemonError):
                ihd.Daemon(url, token="secret").devices()
        self.assertEqual(Server.seen[-1]["authorization"], "Bearer secret")

    def test_an_exception_says_too_that_the_hob_was_not_switched_off(self) -> None:
        # It gives the lease and knows no command.
        with Server(200, b"{}") as url, self.assertRaises(KeyError) as caught:
            with ihd.Daemon(url).device("bench").lease():
                raise KeyError("mine")
        if sys.version_info >= (3, 11):
            self.assertIn("off within 10 s by itself", "".join(caught.exception.__notes__))

    def test_a_stream_that_breaks_is_an_error(self) -> None:
        with Server(200, b'data: {"event":"x"}\n\nevent: missed\ndata: {"missed":3}\n\ndata: {"a"\n\n') as url:
            events = ihd.Daemon(url).events()
            self.assertEqual(next(events), {"event": "x"})
            self.assertEqual(next(events), {"event": "missed", "missed": 3})
            with self.assertRaises(ihd.DaemonError):
                next(events)


class Server:
    """A server that gives every request one answer."""

    seen: list[dict[str, str]] = []

    def __init__(self, status: int, body: bytes) -> None:
        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                Server.seen.append({name.lower(): value for name, value in self.headers.items()})
                self.send_response(status)
                self.send_header("location", "http://127.0.0.1:1/")
                self.end_headers()
                self.wfile.write(body)

            def do_PUT(self) -> None:
                self.rfile.read(int(self.headers["content-length"]))
                self.do_GET()

            def log_message(self, *_: object) -> None:
                pass

        self.server = http.server.HTTPServer(("127.0.0.1", 0), Handler)

    def __enter__(self) -> str:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{self.server.server_port}"

    def __exit__(self, *_: object) -> None:
        self.server.shutdown()
        self.server.server_close()


if __name__ == "__main__":
    unittest.main()
