"""Identification: equal to the program's to the last digit, judged as it judges."""

import pickle
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

import ihd
import numpy as np
from program import CAPTURES, ihd_json
from program import ihd as program

# Refused results end the program with 7.
CODES = (0, 7)


class Equality(unittest.TestCase):
    def same(self, ours: object, theirs: object) -> None:
        """Compares numbers as doubles, what holds numbers part by part, all else as it is."""
        if isinstance(theirs, dict):
            assert isinstance(ours, dict)
            self.assertEqual(ours.keys(), theirs.keys())
            self.same(list(ours.values()), [theirs[name] for name in ours])
        elif isinstance(theirs, list) and not isinstance(ours, np.ndarray):
            assert isinstance(ours, list)
            self.assertEqual(len(ours), len(theirs))
            for one, other in zip(ours, theirs):
                self.same(one, other)
        elif isinstance(theirs, (float, list)):
            np.testing.assert_array_equal(ours, theirs)
        else:
            self.assertEqual(ours, theirs)

    def compare(self, found: ihd.Identification, entries: list[dict]) -> None:
        """Compares every number with those of `ihd identify --json`."""
        self.assertEqual(len(found.estimates), len(entries))
        for estimate, entry in zip(found.estimates, entries):
            self.assertEqual(estimate.method, entry["method"])
            self.same(estimate.f_sw, entry["f_sw_hz"])
            self.assertEqual(estimate.error, entry.get("error"))
            self.same(estimate.t, entry["t_s"])
            self.same(estimate.R, entry["r_ohm"])
            self.same(estimate.L, entry["l_h"])
            for sigma, stated in [(estimate.sigma_R, "r_sigma_ohm"), (estimate.sigma_L, "l_sigma_h")]:
                if entry[stated]:
                    self.same(sigma, entry[stated])
                else:
                    self.assertTrue(np.all(np.isnan(sigma)))
            if "r_power_ohm" in entry:
                self.same(estimate.R_power, entry["r_power_ohm"])
            self.same([estimate.nmse_v, estimate.nmse_i], [entry["nmse_v_pct"], entry["nmse_i_pct"]])
            self.assertEqual(estimate.verdict, entry["gate"]["verdict"])
            self.assertEqual(estimate.why, entry["gate"]["why"])
            self.same([f._asdict() for f in estimate.findings], entry["findings"])
            halves = [
                {"from_s": h.start, "seen": h.seen, "verdict": h.verdict, "why": h.why} for h in estimate.half_cycles
            ]
            self.same(halves, entry["half_cycles"])
            self.assertEqual(estimate.notes, entry["notes"])
            self.assertEqual(estimate.law is None, "pooled" not in entry)
            if estimate.law is not None:
                names = {"i": "i_a", "R": "r_ohm", "L": "l_h", "sigma_R": "r_sigma_ohm", "sigma_L": "l_sigma_h", "chi2": "chi2"}
                for name, stated in names.items():
                    self.same(getattr(estimate.law, name), entry["pooled"][stated])

    def test_each_method_is_the_programs_to_the_last_digit(self) -> None:
        file = CAPTURES / "noisy.mcap"
        capture = ihd.read(file)
        for method in ihd.methods():
            with self.subTest(method=method):
                network = ["--network", "deterministic"] if method == "pinn" else []
                entries = ihd_json("identify", file, "--method", method, *network, exits=CODES)
                self.compare(capture.identify(method, deterministic=method == "pinn"), entries)

    def test_a_stub_is_judged_as_the_program_judges_it(self) -> None:
        capture = ihd.simulate(settings={"load": "behavioural", "duration_s": 20e-3})
        v, fs = capture.v.copy(), 1 / (capture.t[1] - capture.t[0])
        v[int(0.7e-3 * fs)] = np.nan
        found = ihd.identify(v, capture.i, fs, "lockin")
        self.assertEqual([e.verdict for e in found.estimates], ["cannot_tell", "pass"])
        self.assertTrue(found.passed)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "stub.npz")
            np.savez(file, v_V=v, i_A=capture.i, t0_s=0.0, dt_s=1 / fs)
            program("identify", file, "--method", "lockin")

    def test_several_stretches_are_the_programs(self) -> None:
        file = CAPTURES / "frequency-steps.mcap"
        found = ihd.read(file).identify("lockin")
        self.compare(found, ihd_json("identify", file, "--method", "lockin", exits=CODES))
        self.assertGreater(len(found.estimates), 1)
        self.assertEqual(len(found.t), sum(len(e.t) for e in found.estimates))
        self.assertEqual(set(found.f_sw), {e.f_sw for e in found.estimates if len(e.t)})

    def test_a_refused_result_has_its_verdict_and_reasons(self) -> None:
        file = CAPTURES / "saturation.mcap"
        found = ihd.read(file).identify()
        self.compare(found, ihd_json("identify", file, exits=CODES))
        self.assertEqual(found.passed, found.verdict == "pass")
        self.assertEqual(found.passed, not found.why)

    def test_two_half_cycles_have_a_law(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "a.mcap"
            program("simulate", "--set", "load=behavioural,rate=10M", "--out", file)
            found = ihd.read(file).identify()
            self.compare(found, ihd_json("identify", file))
        law = found.estimates[0].law
        assert law is not None
        self.assertTrue(np.all(np.diff(law.i) > 0))
        copied = pickle.loads(pickle.dumps(found))
        np.testing.assert_array_equal(copied.estimates[0].law.R, law.R)
        # Equal to itself alone, as arrays have no one truth.
        self.assertEqual({found, found, copied}, {copied, found})

    def test_options_are_the_programs(self) -> None:
        file = CAPTURES / "noisy.mcap"
        capture = ihd.read(file)
        f_sw = capture.f_sw
        words = f"fsw={f_sw},mains=50"
        entries = ihd_json("identify", file, "--input", words, "--self-calibrate", "off", exits=CODES)
        self.compare(capture.identify(f_sw=f_sw, f_mains=50.0, self_calibrate="off"), entries)


class Arrays(unittest.TestCase):
    def test_arrays_of_a_file_give_what_the_file_gives(self) -> None:
        capture = ihd.simulate("paper-50", settings={"load": "behavioural"})
        assert capture.fs is not None
        found = ihd.identify(capture.v.astype(np.float64), capture.i, capture.fs, "lockin")
        same = capture.identify("lockin")
        # The file states its frequencies, the arrays do not: what is found lies beside it.
        self.assertEqual(len(found.estimates), len(same.estimates))
        np.testing.assert_allclose(np.median(found.R), np.median(same.R), rtol=1e-3)

    def test_r_and_l_of_a_circuit_are_found(self) -> None:
        # v = R i + L di/dt at 45 kHz under the envelope of the rectified mains.
        fs, f_sw, r, l = 10e6, 45e3, 3.0, 22e-6
        t = np.arange(int(0.02 * fs)) / fs
        w, mains = 2 * np.pi * f_sw, 2 * np.pi * 50
        envelope = 30 * np.abs(np.sin(mains * t))
        slope = 30 * mains * np.sign(np.sin(mains * t)) * np.cos(mains * t)
        i = envelope * np.cos(w * t)
        v = r * i + l * (slope * np.cos(w * t) - envelope * w * np.sin(w * t))
        found = ihd.identify(v, i, fs)
        middle = (found.t % 0.01 > 2e-3) & (found.t % 0.01 < 8e-3)
        np.testing.assert_allclose(found.R[middle], r, rtol=1e-3)
        np.testing.assert_allclose(found.L[middle], l, rtol=1e-3)

    def test_what_cannot_be_identified_is_an_error(self) -> None:
        for x in [np.zeros(1000), np.full(1000, np.nan), np.full(1000, 1e300), np.ones(1)]:
            with self.subTest(x=x[0]), self.assertRaises(ihd.IdentifyError):
                ihd.identify(x, x, 1e6)

    def test_wrong_options_are_refused_with_the_right_ones(self) -> None:
        capture = ihd.read(CAPTURES / "noisy.mcap")
        nan, inf = float("nan"), float("inf")
        wrong = [
            ({"method": "magic"}, "least-squares"),
            ({"method": "pinn", "preset": "none"}, "hybrid"),
            ({"preset": "hybrid"}, "pinn"),
            ({"deterministic": True}, "pinn"),
            ({"method": "ekf", "settings": {"start": [2.5, 20.0]}}, "henry"),
            ({"settings": {"lockn": {}}}, "lockin"),
            ({"self_calibrate": "perhaps"}, "report"),
            *(({"f_sw": f}, "1 kHz to 1 MHz") for f in (-1.0, 0.0, nan, inf)),
            *(({"f_mains": f}, "1 Hz to 1 kHz") for f in (0.0, -50.0, nan, inf)),
            *(({"capacitance": c}, "10 nF") for c in (0.0, -1e-6, 1.08, nan, inf)),
            *(({"zero_crossing": t}, "finite") for t in (nan, inf)),
        ]
        for options, says in wrong:
            with self.subTest(options=options), self.assertRaisesRegex(ValueError, says):
                capture.identify(**options)


# ^C in the process's first call, then in one that would last for many minutes.
INTERRUPTED = """
import os, signal, threading, ihd

# A background job of a shell starts with the signal ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)

def interrupted(compute):
    threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        compute()
    except KeyboardInterrupt:
        print("interrupted")

interrupted(lambda: ihd.simulate(settings={"load": "behavioural", "duration_s": 10.0}))
capture = ihd.simulate(settings={"load": "behavioural", "duration_s": 20e-3})
endless = {"pinn": {"config": {"optimiser": "adam", "max_iterations": 10**7, "time_limit_s": 10**6, "tolerance": 0}}}
interrupted(lambda: capture.identify("pinn", settings=endless))
print(capture.identify("lockin").estimates[0].method)
"""


class Threads(unittest.TestCase):
    def test_an_interrupt_ends_a_computation(self) -> None:
        script = [sys.executable, "-c", INTERRUPTED]
        ended = subprocess.run(script, capture_output=True, text=True, timeout=600)
        self.assertEqual((ended.stdout.split(), ended.stderr), (["interrupted", "interrupted", "lockin"], ""))

    def test_other_threads_run_while_it_computes(self) -> None:
        capture = ihd.read(CAPTURES / "noisy.mcap")
        done = threading.Event()
        result: list[ihd.Identification] = []

        def compute() -> None:
            result.append(capture.identify("pinn", deterministic=True))
            done.set()

        thread = threading.Thread(target=compute)
        thread.start()
        turns = 0
        while not done.is_set():
            turns += 1
        thread.join()
        self.assertEqual(len(result), 1)
        # A held lock would leave one turn, or none.
        self.assertGreater(turns, 1000)

    def test_two_threads_give_what_one_gives(self) -> None:
        capture = ihd.read(CAPTURES / "noisy.mcap")
        alone = capture.identify("ekf")
        results: list[ihd.Identification] = []
        threads = [threading.Thread(target=lambda: results.append(capture.identify("ekf"))) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self.assertEqual(len(results), 4)
        for found in results:
            np.testing.assert_array_equal(found.R, alone.R)


if __name__ == "__main__":
    unittest.main()
