"""Runs a notebook's cells: a cell's print-out, its last value and its figures are its outputs. Jupyter and its kernel are
60 packages, for what these lines do."""

import ast
import base64
import contextlib
import io
import json
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("agg")
from matplotlib import pyplot  # noqa: E402

Output = dict[str, Any]


def run(notebook: Path) -> dict[str, Any]:
    """The notebook with the outputs that its cells have now."""
    content = json.loads(notebook.read_text())
    names: dict[str, Any] = {"__name__": "__main__"}
    cells = [cell for cell in content["cells"] if cell["cell_type"] == "code"]
    for count, cell in enumerate(cells, start=1):
        cell["execution_count"] = count
        cell["outputs"] = _run_cell("".join(cell["source"]), f"{notebook.name}[{count}]", count, names)
    return content


def _run_cell(source: str, name: str, count: int, names: dict[str, Any]) -> list[Output]:
    body = ast.parse(source, name)
    last = body.body.pop() if body.body and isinstance(body.body[-1], ast.Expr) else None
    value = None
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(body, name, "exec"), names)
        if last is not None:
            value = eval(compile(ast.Expression(last.value), name, "eval"), names)
    outputs: list[Output] = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": _lines(printed.getvalue())})
    for number in pyplot.get_fignums():
        picture = io.BytesIO()
        # Without the versions in the file.
        pyplot.figure(number).savefig(picture, format="png", metadata={"Software": None})
        data = {"image/png": base64.b64encode(picture.getvalue()).decode()}
        outputs.append({"output_type": "display_data", "data": data, "metadata": {}})
    pyplot.close("all")
    # As in Jupyter.
    if value is not None and not source.rstrip().endswith(";"):
        data = {"text/plain": _lines(repr(value))}
        outputs.append({"output_type": "execute_result", "execution_count": count, "data": data, "metadata": {}})
    return outputs


def texts(content: dict[str, Any]) -> list[str]:
    """All text that its cells have put out."""
    outputs = [output for cell in content["cells"] for output in cell.get("outputs", [])]
    return ["".join(o.get("text", o.get("data", {}).get("text/plain", []))) for o in outputs]


def pictures(content: dict[str, Any]) -> int:
    """Number of figures that its cells have drawn."""
    outputs = [output for cell in content["cells"] for output in cell.get("outputs", [])]
    return sum("image/png" in output.get("data", {}) for output in outputs)


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)
