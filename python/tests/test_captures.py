"""Captures from files and arrays: the same samples as the program's, errors that say what to do."""

import copy
import pickle
import tempfile
import unittest
from pathlib import Path

import ihd
import numpy as np
from program import CAPTURES, FORMATS, ihd as program


class Files(unittest.TestCase):
    def test_every_format_gives_the_samples_that_the_program_converts(self) -> None:
        # File or files, options here, the same for the program.
        cases = [
            (["keysight.csv"], {}, ""),
            (["siglent.csv"], {}, ""),
            (["picoscope_german.csv"], {}, ""),
            (["plain.npz"], {}, ""),
            (["plain.mat"], {}, ""),
            (["picoscope.mat"], {"channels": ("A", 2), "units": ("V", "A")}, "channels=A,2,units=V,A"),
            (["tek_wfm3le_v.wfm", "tek_wfm3le_i.wfm"], {}, ""),
            (["tek_isf_v.isf", "tek_isf_i.isf"], {"invert": "i"}, "invert=i"),
            (["lecroy_v.trc", "lecroy_i.trc"], {"probe": (10, 0.5), "swap": False}, "probe=10,0.5"),
            (["rigol.csv"], {"fs": 4e6, "columns": (1, 3, 2)}, "rate=4M,columns=1,3,2,units=V,A"),
        ]
        cases[-1][1]["units"] = ("V", "A")
        with tempfile.TemporaryDirectory() as folder:
            for files, options, words in cases:
                with self.subTest(files=files):
                    paths = [FORMATS / name for name in files]
                    out = Path(folder) / "out.npz"
                    out.unlink(missing_ok=True)
                    program("convert", *paths, "--out", out, *(["--input", words] if words else []))
                    expected = np.load(out)
                    capture = ihd.read(*paths, **options)
                    np.testing.assert_array_equal(capture.v, expected["v_V"])
                    np.testing.assert_array_equal(capture.i, expected["i_A"])
                    self.assertEqual(capture.v.dtype, np.float32)
                    self.assertEqual(len(capture), len(capture.t))
                    self.assertIsNone(capture.losses)

    def test_a_simulated_capture_has_its_facts_and_truth(self) -> None:
        capture = ihd.read(CAPTURES / "noisy.mcap")
        truth = capture.truth
        assert truth is not None and capture.f_sw is not None
        self.assertEqual(len(truth.t), len(truth.R))
        # A ferromagnetic pot: a few ohm and some ten microhenry.
        self.assertTrue(np.all((truth.R > 0.5) & (truth.R < 16)))
        self.assertTrue(np.all((truth.L > 5e-6) & (truth.L < 64e-6)))
        self.assertIn("simulation", capture.metadata)

    def test_a_cut_file_warns_and_gives_the_rest(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            file, cut = Path(folder) / "whole.mcap", Path(folder) / "cut.mcap"
            program("simulate", "--set", "load=behavioural,duration=20ms,bits=16,snr=20", "--out", file)
            whole = file.read_bytes()
            cut.write_bytes(whole[: len(whole) * 3 // 4])
            with self.assertWarns(ihd.CaptureWarning):
                capture = ihd.read(cut)
            self.assertIsNotNone(capture.losses)
            self.assertLess(0, len(capture))
            self.assertLess(len(capture), len(ihd.read(file)))

    def test_errors_name_file_and_remedy(self) -> None:
        with self.assertRaisesRegex(ihd.CaptureError, "absent.csv"):
            ihd.read("absent.csv")
        # A current alone: the program asks for the other file.
        with self.assertRaisesRegex(ihd.CaptureError, "tek_wfm3le_v.wfm"):
            ihd.read(FORMATS / "tek_wfm3le_v.wfm")
        with tempfile.TemporaryDirectory() as folder:
            empty = Path(folder) / "empty.csv"
            empty.touch()
            with self.assertRaises(ihd.CaptureError):
                ihd.read(empty)
        wrong = [{"invert": "x"}, {"units": ("V", "kg")}, {"fs": 0.0}, {"fs": float("nan")}, {"channels": (1,)}]
        for options in [*wrong, {"probe": (0, 1)}, {"probe": (1, float("inf"))}]:
            with self.subTest(options=options), self.assertRaises(ValueError):
                ihd.read(FORMATS / "keysight.csv", **options)


class Arrays(unittest.TestCase):
    def test_every_layout_and_type_gives_the_same_capture(self) -> None:
        x = np.linspace(-300, 300, 1001)
        interleaved = np.stack([x, x / 10], axis=1)
        # Of 13 bytes, no multiple of a sample's size.
        packed = np.zeros(len(x), dtype=[("flag", "u1"), ("v", "f8"), ("i", "f4")])
        packed["v"], packed["i"] = x, x / 10
        layouts = [
            (x, x / 10),
            (x.astype(np.float32), (x / 10).astype(np.float32)),
            (interleaved[:, 0], interleaved[:, 1]),
            (x[::-1][::-1], (x / 10).tolist()),
            (x.astype(">f8"), np.ascontiguousarray(x / 10, dtype="<f4")),
            (np.broadcast_to(x, (1, len(x)))[0], x / 10),
            (packed["v"], packed["i"]),
            (packed[::-1]["v"][::-1], x / 10),
        ]
        for v, i in layouts:
            capture = ihd.Capture(v, i, 1e6, t0=-1e-3)
            np.testing.assert_array_equal(capture.v, x.astype(np.float32))
            np.testing.assert_array_equal(capture.i, (x / 10).astype(np.float32))
            self.assertEqual(capture.t[0], -1e-3)
            self.assertAlmostEqual(capture.fs, 1e6, delta=1e-3)
        integers = ihd.Capture(np.arange(5), np.arange(5), 1e6)
        np.testing.assert_array_equal(integers.v, np.arange(5))

    def test_the_arrays_are_the_captures_own_and_not_those_given(self) -> None:
        v = np.ones(10)
        capture = ihd.Capture(v, v, 1e6)
        v[:] = 2
        self.assertEqual(capture.v[0], 1)
        # Their shape and type are the caller's own, their samples the capture's.
        view = capture.v
        view.shape = (2, 5)
        view[0, 1] = 7
        self.assertEqual(len(capture), 10)
        self.assertEqual(capture.v.tolist(), [1, 7, *[1] * 8])

    def test_a_copy_is_the_same_capture_with_samples_of_its_own(self) -> None:
        simulated = ihd.simulate("paper-50", settings={"load": "behavioural", "duration_s": 2e-3})
        stamped = ihd.read(FORMATS / "plain.npz", swap=True, probe=(2, 3))
        for capture in (simulated, stamped):
            for copied in (copy.deepcopy(capture), pickle.loads(pickle.dumps(capture))):
                for name in ("v", "i", "t"):
                    np.testing.assert_array_equal(getattr(copied, name), getattr(capture, name))
                for name in ("name", "fs", "f_sw", "f_mains", "zero_crossing", "full_scale", "metadata", "losses"):
                    self.assertEqual(getattr(copied, name), getattr(capture, name), name)
                self.assertFalse(np.shares_memory(copied.v, capture.v))
                self.assertEqual(copied.truth is None, capture.truth is None)
        np.testing.assert_array_equal(copy.deepcopy(simulated).truth.R, simulated.truth.R)
        truth = pickle.loads(pickle.dumps(simulated.truth))
        np.testing.assert_array_equal(truth.L, simulated.truth.L)

    def test_masked_samples_are_missing_ones(self) -> None:
        for dtype in (np.float64, np.float32, np.int16, "u1"):
            v = np.ma.masked_array(np.ones(5, dtype), mask=[0, 0, 1, 0, 0])
            self.assertEqual(np.flatnonzero(np.isnan(ihd.Capture(v, np.ones(5), 1e6).v)).tolist(), [2])

    def test_wrong_arrays_are_refused(self) -> None:
        x = np.ones(10)
        wrong = [
            (x, x[:5], 1e6, "10 samples, i has 5"),
            (x[:0], x[:0], 1e6, "empty"),
            (np.ones((5, 2)), x, 1e6, "v: has 2 axes"),
            (x, x, 0.0, "fs=0"),
            (x, x, float("inf"), "fs=inf"),
            (x, x, -1.0, "fs=-1"),
        ]
        for v, i, fs, says in wrong:
            with self.subTest(says=says), self.assertRaisesRegex(ValueError, says):
                ihd.Capture(v, i, fs)
        for v in (["a"], [1j], [None], [True]):
            with self.subTest(v=v), self.assertRaisesRegex(TypeError, "numbers"):
                ihd.Capture(v, v, 1e6)
        with self.assertRaisesRegex(ValueError, "t0=NaN"):
            ihd.Capture(x, x, 1e6, t0=float("nan"))


if __name__ == "__main__":
    unittest.main()
