"""Writes field.csv: R and L by finite elements for the arrangements that the field model is compared with.

    python3 -m venv .venv && .venv/bin/pip install -r requirements.txt
    .venv/bin/python compare.py              # field.csv, convergence.csv, some five minutes
    .venv/bin/python compare.py coil.toml    # R and L of one's own arrangements
"""

import csv
import datetime
import sys
import tomllib
from dataclasses import fields as names
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

from fields import ALUMINIUM, CAST_IRON, COPPER, MU_0, PAPER, PAPER_SATURATING, STAINLESS, Case, Field, Mesh, Metal

METALS = {
    "none": None,
    "aluminium": ALUMINIUM,
    "copper": COPPER,
    "stainless-304": STAINLESS,
    "ferritic": PAPER,
    "cast-iron": CAST_IRON,
    "ferritic-saturating": PAPER_SATURATING,
    # Aluminium on a foil.
    "clad": ALUMINIUM,
    "clad-saturating": ALUMINIUM,
}
FOILS = {"clad": PAPER, "clad-saturating": PAPER_SATURATING}
FOIL_MM = 0.5
COLUMNS = ["metal", "diameter_mm", "thickness_mm", "wall_mm", "lift_mm", "shield_mm", "f_khz", "current_a"]
HERE = Path(__file__).parent


def rows():
    """Arrangements of the table: metal, pot's diameter, thickness, wall, lift, shield in mm, kHz, A."""
    for shield in (0, 1):
        for f in (30, 45, 80):
            yield "none", 210, 5, 0, 0, shield, f, 0
    for metal in ("aluminium", "copper", "stainless-304", "ferritic", "cast-iron"):
        for diameter in (80, 120, 180, 210, 280):
            for lift in (0, 10):
                for f in (30, 45, 80):
                    yield metal, diameter, 5, 0, lift, 1, f, 0
        for diameter in (120, 210):
            yield metal, diameter, 5, 0, 5, 1, 45, 0
    for diameter in (120, 180, 210):
        for f in (30, 80):
            yield "stainless-304", diameter, 2, 0, 0, 1, f, 0
            yield "ferritic", diameter, 5, 100, 0, 1, f, 0
        for metal in ("aluminium", "stainless-304"):
            yield metal, diameter, 5, 100, 0, 1, 45, 0
    for diameter in (120, 180, 210):
        for current in (10, 40):
            yield "ferritic-saturating", diameter, 5, 0, 0, 1, 45, current
            yield "clad-saturating", diameter, 5, 0, 0, 1, 45, current
    for diameter in (80, 120, 180, 210, 280):
        for f in (30, 45, 80):
            yield "clad", diameter, 5, 0, 0, 1, f, 0
    for diameter in (120, 210):
        yield "clad", diameter, 5, 0, 10, 1, 45, 0


def case(row):
    metal, diameter, thickness, wall, lift, shield, f, current = row
    return replace(
        Case(), pot=METALS[metal], pot_radius_m=diameter / 2e3, pot_thickness_m=thickness / 1e3,
        foil=FOILS.get(metal), foil_thickness_m=FOIL_MM / 1e3 if metal in FOILS else 0.0, wall_height_m=wall / 1e3, load_gap_m=Case.load_gap_m + lift / 1e3,
        shield_thickness_m=shield / 1e3, f_hz=f * 1e3, current_a=current)


def stamp():
    packages = ", ".join(f"{p} {version(p)}" for p in ("scikit-fem", "numpy", "scipy"))
    return f"# {datetime.date.today()}, {packages}, {Mesh()}"


def table(path):
    with open(path, "w") as file:
        file.write(stamp() + "\n")
        write = csv.writer(file, lineterminator="\n")
        write.writerow(COLUMNS + ["r_ohm", "l_uh"])
        for row in rows():
            r, l, _ = Field(case(row)).impedance()
            write.writerow([*row, f"{r:.5g}", f"{l * 1e6:.6g}"])
            file.flush()


def convergence(path):
    """R and L against the mesh and the far boundary."""
    with open(path, "w") as file:
        file.write(stamp() + "\n")
        write = csv.writer(file, lineterminator="\n")
        write.writerow(COLUMNS + ["fine", "far_m", "unknowns", "r_ohm", "l_uh"])
        for row in (("none", 210, 5, 0, 0, 1, 45, 0), ("aluminium", 120, 5, 0, 0, 1, 45, 0),
                    ("stainless-304", 120, 2, 0, 0, 1, 45, 0), ("ferritic", 120, 5, 0, 0, 1, 45, 0),
                    ("ferritic", 210, 5, 0, 0, 1, 80, 0), ("cast-iron", 80, 5, 0, 10, 1, 30, 0)):
            for fine, far in ((1, 0.8), (1.5, 0.8), (2, 0.8), (1, 0.5), (1, 1.2)):
                r, l, n = Field(case(row), Mesh(fine=fine, far_m=far)).impedance()
                write.writerow([*row, fine, far, n, f"{r:.6g}", f"{l * 1e6:.7g}"])
                file.flush()


def own(path):
    """Arrangements of a TOML file with the keys of host/field's Geometry (metre), f_hz, current_a and [metal]."""
    for entry in tomllib.loads(Path(path).read_text())["case"]:
        metal, foil = (entry.pop(key, None) for key in ("metal", "foil"))
        of = lambda m: m and Metal(m["mu_r"], m["sigma_s_per_m"], m.get("alpha_a_per_m", float("inf")))
        renamed = {"load_radius_m": "pot_radius_m", "load_thickness_m": "pot_thickness_m"}
        entry = {renamed.get(key, key): value for key, value in entry.items()}
        unknown = set(entry) - {f.name for f in names(Case)} - {"name"}
        if unknown:
            raise SystemExit(f"{path}: unknown keys {sorted(unknown)}")
        name = entry.pop("name", "")
        r, l, n = Field(replace(Case(), pot=of(metal), foil=of(foil), **entry)).impedance()
        print(f"{name:24} {r:9.5f} ohm {l * 1e6:9.4f} µH  ({n} unknowns)")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        own(sys.argv[1])
    else:
        convergence(HERE / "convergence.csv")
        table(HERE / "field.csv")
