"""Examples of README.md, each run as it stands there."""

import contextlib
import io
import os
import re
import tempfile
import unittest
from pathlib import Path

from kitchen import kitchen, learn
from program import ROOT
from program import ihd as program

PAGE = ROOT / "python/README.md"


class Examples(unittest.TestCase):
    def test_every_example_runs(self) -> None:
        examples = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
        self.assertEqual(len(examples), 5)
        learn(1)
        here = Path.cwd()
        with tempfile.TemporaryDirectory() as folder:
            capture = Path(folder) / "a.mcap"
            program("simulate", "--set", "load=behavioural,rate=10M,snr=40", "--out", capture)
            program("convert", capture, "--out", Path(folder) / "scope.csv")
            (Path(folder) / "ihd-store").symlink_to(kitchen().store)
            try:
                os.chdir(folder)
                for example in examples:
                    with self.subTest(example=example), contextlib.redirect_stdout(io.StringIO()) as printed:
                        exec(compile(example.replace("http://127.0.0.1:8731", kitchen().url), str(PAGE), "exec"), {})
                    self.assertTrue(printed.getvalue().strip())
            finally:
                os.chdir(here)


if __name__ == "__main__":
    unittest.main()
