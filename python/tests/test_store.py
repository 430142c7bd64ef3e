"""A daemon's store as columns, read while the daemon writes: what the program lists."""

import tempfile
import unittest
from datetime import datetime, timedelta, timezone
from pathlib import Path

import ihd
import numpy as np
from kitchen import kitchen, learn, wait_for_telemetry
from program import ihd as program
from program import ihd_json


class Stored(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        cls.window = learn(3)
        cls.store = ihd.Store(kitchen().store)
        wait_for_telemetry()

    def test_results_are_those_that_the_program_lists(self) -> None:
        results = self.store.results("bench")
        listed = ihd_json("store", "ls", "--device", "bench", "--store", kitchen().store)
        assert isinstance(listed, list)
        # The program's are the newest first, at most 20 or so; no window came since.
        newest = {name: column[::-1][: len(listed)] for name, column in results.items()}
        self.assertGreaterEqual(len(listed), 3)
        for name in ["boot", "seq", "f_sw_hz", "r_ohm", "l_h", "i_crest_a", "sigma_r_pct", "why"]:
            self.assertEqual(list(newest[name]), [row[name] for row in listed], name)

    def test_columns_have_types_and_one_length(self) -> None:
        tables = [self.store.results(), self.store.windows(), self.store.events(), self.store.telemetry("bench", minutes=False)]
        for columns in tables:
            self.assertEqual(len({len(column) for column in columns.values()}), 1)
            self.assertEqual(columns["at"].dtype, np.dtype("datetime64[ms]"))
            self.assertTrue(np.all(np.diff(columns["at"]) >= np.timedelta64(0)))
            self.assertGreater(len(columns["at"]), 0)
        self.assertEqual(tables[0]["passed"].dtype, bool)
        self.assertEqual(tables[0]["r_ohm"].dtype, np.float64)

    def test_time_and_device_narrow_a_table(self) -> None:
        later = datetime.now(timezone.utc) + timedelta(days=1)
        for read in (self.store.results, self.store.windows, self.store.events):
            self.assertEqual(len(read(since=later)["at"]), 0)
            self.assertEqual(len(read("nobody")["at"]), 0)
            every = read()["at"]
            since = every[len(every) // 2]
            np.testing.assert_array_equal(read(since=since)["at"], every[every >= since])
        # An hour of another zone is the same moment.
        berlin = later.astimezone(timezone(timedelta(hours=2)))
        self.assertEqual(len(self.store.results(since=berlin)["at"]), 0)

    def test_a_windows_samples_are_those_of_the_export(self) -> None:
        window = self.window
        capture = self.store.capture("bench", window.boot, window.seq)
        with tempfile.TemporaryDirectory() as folder:
            program("store", "export", "--format", "npz", "--store", kitchen().store, "--out", folder)
            file = Path(folder) / f"bench-{window.boot}-{window.seq}.npz"
            exported = ihd.read(file)
        np.testing.assert_array_equal(capture.v, exported.v)
        np.testing.assert_array_equal(capture.i, exported.i)
        self.assertAlmostEqual(capture.identify("lockin").estimates[0].f_sw, window.f_sw, delta=1)
        with self.assertRaises(KeyError):
            self.store.capture("bench", window.boot, 10**9)

    def test_telemetry_has_the_heating(self) -> None:
        seconds = self.store.telemetry("bench", minutes=False)
        self.assertGreater(np.nanmax(seconds["power_max_w"]), 500)
        heats = np.isfinite(seconds["r_mean_ohm"])
        self.assertTrue(np.all(seconds["r_min_ohm"][heats] <= seconds["r_max_ohm"][heats]))
        self.assertTrue(np.all((seconds["l_mean_h"][heats] > 2e-6) & (seconds["l_mean_h"][heats] < 100e-6)))

    def test_frames_have_the_columns_with_their_types(self) -> None:
        results = self.store.results()
        frame, table = results.to_pandas(), results.to_arrow()
        self.assertEqual(list(frame), list(results))
        self.assertEqual(table.column_names, list(results))
        for name, column in results.items():
            np.testing.assert_array_equal(frame[name].to_numpy(), column, name)
            np.testing.assert_array_equal(table[name].to_numpy(), column, name)
        self.assertEqual(frame["at"].dtype, np.dtype("datetime64[ms]"))
        self.assertEqual(str(table.schema.field("at").type), "timestamp[ms]")
        self.assertEqual(str(table.schema.field("device").type), "string")


class Errors(unittest.TestCase):
    def test_a_folder_without_a_store_is_named(self) -> None:
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(ihd.StoreError, Path(folder).name):
                ihd.Store(folder)
            (Path(folder) / "ihd.db").write_bytes(b"no database")
            with self.assertRaises(ihd.StoreError):
                ihd.Store(folder)
            self.assertEqual(sorted(p.name for p in Path(folder).iterdir()), ["ihd.db"])


if __name__ == "__main__":
    unittest.main()
