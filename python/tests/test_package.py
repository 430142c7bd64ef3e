"""The package itself: what is installed, its types, its stubs."""

import ast
import importlib.metadata
import inspect
import unittest
from importlib.resources import files
from pathlib import Path
from typing import get_type_hints

import ihd
from ihd import _native
from program import ROOT


class Package(unittest.TestCase):
    def test_the_installed_wheel_serves_every_python_and_has_types(self) -> None:
        self.assertNotEqual(Path(ihd.__file__).parent, ROOT / "python/ihd")
        wheel = importlib.metadata.distribution("ihd").read_text("WHEEL") or ""
        self.assertIn("Tag: cp310-abi3-", wheel)
        for name in ("py.typed", "_native.pyi"):
            self.assertTrue(files("ihd").joinpath(name).is_file(), name)

    def test_every_public_name_is_described(self) -> None:
        for name in ihd.__all__:
            thing = getattr(ihd, name)
            if callable(thing) and name != "Verdict":
                self.assertTrue(inspect.getdoc(thing), name)

    def test_annotations_resolve(self) -> None:
        for name in ihd.__all__:
            thing = getattr(ihd, name)
            for member in [thing, *vars(thing).values()] if inspect.isclass(thing) else [thing]:
                if inspect.isfunction(member) and member.__name__ not in ("to_pandas", "to_arrow"):
                    get_type_hints(member)

    def test_stubs_name_what_the_extension_has(self) -> None:
        stub = ast.parse(files("ihd").joinpath("_native.pyi").read_text())
        public = {name for name in vars(_native) if not name.startswith("_")}
        kinds = (ast.ClassDef, ast.FunctionDef)
        described = {node.name: node for node in stub.body if isinstance(node, kinds)}
        self.assertEqual(set(described), public)
        for name, node in described.items():
            there = getattr(_native, name)
            if isinstance(node, ast.FunctionDef):
                self.same_parameters(name, node, there)
                continue
            for member in node.body:
                if isinstance(member, ast.FunctionDef) and not member.name.startswith("__"):
                    self.same_parameters(f"{name}.{member.name}", member, getattr(there, member.name))
                elif isinstance(member, ast.AnnAssign):
                    assert isinstance(member.target, ast.Name)
                    self.assertTrue(hasattr(there, member.target.id), f"{name}.{member.target.id}")
            own = {member for member in vars(there) if not member.startswith("_")}
            stated = {m.target.id for m in node.body if isinstance(m, ast.AnnAssign) and isinstance(m.target, ast.Name)}
            stated |= {m.name for m in node.body if isinstance(m, ast.FunctionDef)}
            self.assertLessEqual(own, stated, name)

    def same_parameters(self, name: str, stub: ast.FunctionDef, there: object) -> None:
        parameters = inspect.signature(there).parameters.values()  # type: ignore[arg-type]
        keywords = [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]
        others = [p.name for p in parameters if p.kind is not p.KEYWORD_ONLY]
        self.assertEqual([a.arg for a in stub.args.args], others, name)
        self.assertEqual([a.arg for a in stub.args.kwonlyargs], keywords, name)


if __name__ == "__main__":
    unittest.main()
