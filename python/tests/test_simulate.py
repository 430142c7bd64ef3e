"""Simulation: the program's recording, with its truth."""

import tempfile
import unittest
from pathlib import Path

import ihd
import numpy as np
from program import ihd as program

SHORT = {"load": "behavioural", "duration_s": 2e-3}


class Simulation(unittest.TestCase):
    def test_samples_and_truth_are_the_programs(self) -> None:
        settings = {**SHORT, "sensing": {"snr_db": 30.0}}
        capture = ihd.simulate("paper-60", 7, settings)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "a.mcap"
            words = "load=behavioural,duration=2ms,snr=30"
            program("simulate", "paper-60", "--seed", 7, "--set", words, "--out", file)
            recorded = ihd.read(file)
        np.testing.assert_array_equal(capture.v, recorded.v)
        np.testing.assert_array_equal(capture.i, recorded.i)
        self.assertEqual(capture.fs, recorded.fs)
        self.assertEqual(capture.metadata["simulation"], recorded.metadata["simulation"])
        truth, expected = capture.truth, recorded.truth
        assert truth is not None and expected is not None
        np.testing.assert_array_equal(truth.R, expected.R)
        np.testing.assert_array_equal(truth.L, expected.L)

    def test_a_seed_decides_the_noise(self) -> None:
        settings = {**SHORT, "sensing": {"snr_db": 30.0}}
        one, same, other = (ihd.simulate("paper-45", seed, settings) for seed in (1, 1, 2))
        np.testing.assert_array_equal(one.v, same.v)
        self.assertTrue(np.any(one.v != other.v))

    def test_every_preset_is_simulated(self) -> None:
        for preset, f_sw in zip(ihd.presets(), [45e3, 50e3, 60e3, 70e3]):
            capture = ihd.simulate(preset, settings=SHORT)
            self.assertEqual(capture.f_sw, f_sw)

    def test_wrong_settings_are_refused_with_the_right_ones(self) -> None:
        wrong = [
            (("paper-55", None, {}), "paper-45"),
            (("paper-45", None, {"f_sw": 45e3}), "unknown setting f_sw: there are .*f_sw_hz"),
            (("paper-45", None, {"sensing": {"snr": 30}}), "sensing.snr: there are .*snr_db"),
            (("paper-45", None, {"f_sw_hz": 1e9}), "f_sw_hz"),
            (("paper-45", None, {"f_sw_hz": "fast"}), "fast"),
        ]
        for arguments, says in wrong:
            with self.subTest(says=says), self.assertRaisesRegex(ValueError, says):
                ihd.simulate(*arguments)


if __name__ == "__main__":
    unittest.main()
