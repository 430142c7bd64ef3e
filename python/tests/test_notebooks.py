"""Notebooks: every cell runs, and puts out the text that is committed. UPDATE_DOCS=1 writes the outputs."""

import json
import os
import unittest
from unittest import mock

import notebook
from kitchen import kitchen, learn, wait_for_telemetry
from program import ROOT

FOLDER = ROOT / "python/notebooks"

# Its hob is another one each time.
OF_A_STORE = "store.ipynb"


class Notebooks(unittest.TestCase):
    def setUp(self) -> None:
        self.addCleanup(os.chdir, os.getcwd())
        os.chdir(FOLDER)

    def test_every_notebook_gives_its_committed_outputs(self) -> None:
        names = sorted(file.name for file in FOLDER.glob("*.ipynb"))
        self.assertEqual(len(names), 4)
        for name in names:
            if name != OF_A_STORE:
                with self.subTest(notebook=name):
                    self.run_notebook(name, same_text=True)

    def test_the_stores_notebook_runs_on_a_store(self) -> None:
        for power_w in (700, 1200, 1700):
            learn(2, power_w)
        wait_for_telemetry()
        with mock.patch.dict(os.environ, IHD_STORE=str(kitchen().store)):
            self.run_notebook(OF_A_STORE, same_text=False)

    def run_notebook(self, name: str, same_text: bool) -> None:
        committed = json.loads((FOLDER / name).read_text())
        now = notebook.run(FOLDER / name)
        if os.environ.get("UPDATE_DOCS") == "1":
            (FOLDER / name).write_text(json.dumps(now, indent=1, ensure_ascii=False) + "\n")
            return
        if same_text:
            self.assertEqual(notebook.texts(committed), notebook.texts(now), "UPDATE_DOCS=1 writes the outputs")
        self.assertEqual(notebook.pictures(committed), notebook.pictures(now))
        self.assertGreater(notebook.pictures(now), 0)


if __name__ == "__main__":
    unittest.main()
