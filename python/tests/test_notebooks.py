"""Notebooks: every cell runs, and puts out the text that is committed. UPDATE_DOCS=1 writes the outputs."""

import json
import os
import unittest

import notebook
from program import ROOT

FOLDER = ROOT / "python/notebooks"


class Notebooks(unittest.TestCase):
    def test_every_notebook_gives_its_committed_outputs(self) -> None:
        files = sorted(FOLDER.glob("*.ipynb"))
        self.assertEqual(len(files), 3)
        here = os.getcwd()
        try:
            os.chdir(FOLDER)
            for file in files:
                with self.subTest(notebook=file.name):
                    committed = json.loads(file.read_text())
                    now = notebook.run(file)
                    if os.environ.get("UPDATE_DOCS") == "1":
                        file.write_text(json.dumps(now, indent=1, ensure_ascii=False) + "\n")
                        continue
                    self.assertEqual(notebook.texts(committed), notebook.texts(now), "UPDATE_DOCS=1 writes the outputs")
                    self.assertEqual(notebook.pictures(committed), notebook.pictures(now))
                    self.assertGreater(notebook.pictures(now), 0)
        finally:
            os.chdir(here)


if __name__ == "__main__":
    unittest.main()
