#!/usr/bin/env python3
"""Draws docs/schematic.svg and prints the arithmetic of docs/board.md. Standard library only.

    python3 docs/schematic.py            # writes docs/schematic.svg, prints the values
    python3 docs/schematic.py --check    # fails if the picture is not what this writes

The scales that the firmware reads by come from its sources, so a scale that changes there shows as an
error here. What sets a scale or a corner stands once, in PARTS; picture and arithmetic take it from there.
"""

import math
import re
import sys
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "docs" / "schematic.svg"


BOARD = tomllib.loads((ROOT / "boards" / "reference.toml").read_text())


def constant(path, name):
    """A number from a Rust source: `NAME: T = 12_3.4`, or the first number after it."""
    text = (ROOT / path).read_text()
    found = re.search(rf"{name}: \w+ = \(?([\d_.]+)", text)
    if not found:
        sys.exit(f"{path} has no constant {name}")
    return float(found[1].replace("_", ""))


I_TRIP_A = BOARD["limits"]["trip_current_ma"] / 1e3
MAINS_ARMED_CODE = constant("firmware/src/sense/mains.rs", "ARMING_CODES")
C_R_NF = BOARD["bridge"]["resonance_capacitance_nf"]
F_MIN_HZ = BOARD["rating"]["f_sw_min_hz"]
F_MAX_HZ = BOARD["rating"]["f_sw_max_hz"]
DEAD_TIME_NS = BOARD["bridge"]["dead_time_ns"]
TICK_HZ = 8 * 170e6
# Resistance at 25 °C, B, resistor to 3V3.
NTCS = {
    sensor: [BOARD["thermistors"][f"{sensor}_{key}"] for key in ("ntc_ohm", "ntc_b_k", "pull_up_ohm")]
    for sensor in ("heat_sink", "glass", "coil")
}
V_REF_V, V_ADC_V, HALF_CODES = 1.65, 3.3, 2048

FRONT_END = BOARD["front_end"]
# The parts, in ohm, farad and turns: E96 resistors, E6 or E12 capacitors.
PARTS = {
    "series": 4,
    # Three and one: no ratio of two E96 values comes as near to 640 V.
    "coil_top": 64.9e3,
    "coil_last": 63.4e3,
    "coil_bottom": FRONT_END["coil_divider_bottom_ohm"],
    "mains_top": FRONT_END["mains_divider_ohm"] / 4,
    "mains_bottom": FRONT_END["mains_divider_bottom_ohm"],
    "mains_c": FRONT_END["mains_amplifier_pf"] * 1e-12,
    "bus_top": FRONT_END["bus_divider_ohm"] / 4,
    "bus_bottom": FRONT_END["bus_divider_bottom_ohm"],
    "bus_c": FRONT_END["bus_divider_pf"] * 1e-12,
    "turns": FRONT_END["current_transformer_turns"],
    "ct_l": FRONT_END["current_transformer_mh"] / 1e3,
    "ct_r": FRONT_END["current_transformer_mohm"] / 1e3,
    "burden": FRONT_END["burden_mohm"] / 1e3,
    "pin_r": FRONT_END["pin_ohm"],
    "pin_c_fast": FRONT_END["fast_pin_pf"] * 1e-12,
    "pin_c_slow": FRONT_END["slow_pin_pf"] * 1e-12,
    "bleeder": BOARD["supply"]["bleeder_ohm"],
    "dc_link": BOARD["supply"]["link_capacitance_nf"] * 1e-9,
    "x2": BOARD["supply"]["terminal_capacitance_nf"] * 1e-9,
    "x2_bleeder": 2 * 330e3,
    "c_r": 4 * 270e-9,
    "r_boot": 10.0,
    "c_boot": 1e-6,
    "snubber": 2 * 6.8e-9,
}


def corner_hz(r, c):
    return 1 / (2 * math.pi * r * c)


def parallel(a, b):
    return a * b / (a + b)


def ohm(r):
    """As a label: three digits."""
    return f"{r / 1e3:g} kΩ" if r >= 1e3 else f"{r:g} Ω"


def farad(c):
    for unit, name in ((1e-6, "µF"), (1e-9, "nF")):
        if c >= 0.1 * unit:
            return f"{c / unit:.3g} {name}"
    return f"{c * 1e12:.3g} pF"


def coil_chain_ohm():
    chain = (PARTS["series"] - 1) * PARTS["coil_top"] + PARTS["coil_last"]
    if chain != FRONT_END["coil_divider_ohm"]:
        sys.exit(f"boards/reference.toml has a chain of {FRONT_END['coil_divider_ohm']} ohm, its resistors {chain:g} ohm")
    return chain


def full_scales():
    """Coil voltage, mains, bus in volt; coil current in ampere."""
    p, n = PARTS, PARTS["series"]
    return (
        V_REF_V * coil_chain_ohm() / p["coil_bottom"],
        V_REF_V * n * p["mains_top"] / p["mains_bottom"],
        V_ADC_V * (n * p["bus_top"] / p["bus_bottom"] + 1),
        V_REF_V / p["burden"] * p["turns"],
    )


def values():
    """The arithmetic, as (name, number, unit, how)."""
    p, n = PARTS, PARTS["series"]
    rows = []

    def row(name, number, unit, how):
        rows.append((name, number, unit, how))
        return number

    coil, mains, bus, amps = full_scales()
    row("coil voltage, full scale", coil, "V", "1.65 V · 258.1 kΩ / 665 Ω")
    row("mains voltage, full scale", mains, "V", "1.65 V · 928 kΩ / 3.83 kΩ")
    row("bus voltage, full scale", bus, "V", "3.3 V · (928 kΩ / 6.19 kΩ + 1)")
    row("coil current, full scale", amps, "A", "1.65 V / 4.12 Ω · 200")
    pole = corner_hz(p["pin_r"], p["pin_c_fast"])
    row("anti-alias pole", pole / 1e3, "kHz", "316 Ω · 1 nF")
    row("its time constant", p["pin_r"] * p["pin_c_fast"] * 1e9, "ns", "316 Ω · 1 nF")
    slow = corner_hz(p["pin_r"], p["pin_c_slow"])
    row("pole at PB0 and PB1", slow / 1e3, "kHz", "316 Ω · 10 nF")
    at_mains = corner_hz(p["mains_bottom"], p["mains_c"])
    row("pole of the mains amplifier", at_mains / 1e3, "kHz", "3.83 kΩ · 2.2 nF")
    r_bus = parallel(n * p["bus_top"], p["bus_bottom"])
    row("pole of the bus divider", corner_hz(r_bus, p["bus_c"]) / 1e3, "kHz", "6.15 kΩ · 2.2 nF")
    trip = math.floor(I_TRIP_A * HALF_CODES / amps)
    level = HALF_CODES + trip
    row("trip level of DAC and comparators", level, "code", f"2048 + {trip}")
    row("trip level at PA1 and PA7", V_ADC_V * level / 4096, "V", "at VDDA = 3.300 V")
    row("trip current", trip * amps / HALF_CODES, "A", "")
    row("DC through the burden that trips", trip / HALF_CODES * V_REF_V / p["burden"], "A", "")
    row("mains that arms the crossing detector", MAINS_ARMED_CODE * mains / HALF_CODES, "V", "crest")
    m = math.ceil(TICK_HZ / (61 * F_MAX_HZ))
    f_top = TICK_HZ / (61 * m)
    row("highest frequency of the grid", f_top / 1e3, "kHz", f"1.36 GHz / (61 · {m})")
    row("its period", 1e6 / f_top, "µs", "")
    row("each gate is high for", 0.5e6 / f_top - DEAD_TIME_NS / 1e3, "µs", "half a period less the dead time")
    row("sampling period there", 3 * m / TICK_HZ * 1e9, "ns", "")
    discharge = parallel(p["bleeder"], n * p["bus_top"] + p["bus_bottom"])
    row("bleeder and divider: bus from 325 V to 34 V", discharge * p["dc_link"] * math.log(325 / 34), "s", "")
    row("bleeder and divider: bus from 325 V to 10 V", discharge * p["dc_link"] * math.log(325 / 10), "s", "")
    row("bleeder's power", 230**2 / p["bleeder"], "W", "both resistors")
    row("X2: 325 V to 34 V", p["x2_bleeder"] * p["x2"] * math.log(325 / 34), "s", "")
    v_r = 76 / (2 * math.pi * F_MIN_HZ * p["c_r"])
    row("C_r at 76 A and 34 kHz, amplitude", v_r, "V", "76 A / (ω C_r)")
    row("C_r's crest", v_r + 325 / 2, "V", "with half of the bus")
    v_x_rms = math.hypot(v_r / math.sqrt(2), 325 / 2)
    row("power of one 64.9 kΩ at the most", 1e3 * (v_x_rms / n) ** 2 / p["coil_top"], "mW", "at node X")
    row("crest voltage of one 64.9 kΩ", (v_r + 325 / 2) / n, "V", "")
    row("power of one 232 kΩ of the bus", 1e3 * (230 / n) ** 2 / p["bus_top"], "mW", "")
    row("burden's power at 54 A rms", (54 / p["turns"]) ** 2 * p["burden"], "W", "76 A / √2")
    row("phase error of the transformer at 34 kHz", 1e3 * (p["burden"] + p["ct_r"]) / (2 * math.pi * F_MIN_HZ * p["ct_l"]), "mrad", "(4.12 + 3) Ω / (ω · 80 mH)")
    row("bootstrap: time constant", p["r_boot"] * p["c_boot"] * 1e6, "µs", "10 Ω · 1 µF")
    row("bootstrap: droop for a gate charge of 200 nC", 200e-9 / p["c_boot"], "V", "")
    row("current that finishes an edge in the dead time", p["snubber"] * 325 / (DEAD_TIME_NS * 1e-9), "A", "13.6 nF · 325 V / 1 µs")
    row("clamp current at an amplifier's 5 V", (5 - 3.3 - 0.35) / p["pin_r"] * 1e3, "mA", "")
    f_slow = f_top * 61 / 3 / 2
    row("ADC3's input as a resistance", 1e-3 / (f_slow * 5e-12), "kΩ", "1 / (813 kHz · 5 pF)")
    for name, r25, beta, up, temperatures in (
        ("heat sink", *NTCS["heat_sink"], (-20, 25, 85, 150)),
        ("glass, coil", *NTCS["glass"], (-20, 25, 85, 200, 300)),
    ):
        for celsius in temperatures:
            ntc = r25 * math.exp(beta * (1 / (celsius + 273.15) - 1 / 298.15))
            row(f"NTC {name} at {celsius} °C", V_ADC_V * ntc / (ntc + up), "V", f"{ntc / 1e3:.3g} kΩ")
    gain = coil_chain_ohm() / p["coil_bottom"]
    row("chain of the coil voltage over its bottom", gain, "", "")
    row("both inputs of U3A with SW at 325 V", (gain * V_REF_V + 325) / (gain + 1), "V", "")
    row("U3A's slope at an edge of 325 V in 0.2 µs", 325 / 0.2 / gain, "V/µs", "")
    row("a code of the coil voltage", 1e3 * coil / HALF_CODES, "mV", "")
    row("its rounding", 1e3 * coil / HALF_CODES / math.sqrt(12), "mV", "rms")
    r_noise = parallel(coil_chain_ohm(), p["coil_bottom"])
    thermal = math.sqrt(4 * 1.38e-23 * 300 * 2 * r_noise + (5e-9) ** 2) * (gain + 1) * math.sqrt(math.pi / 2 * pole)
    row("noise of chain and U3A, 5 nV/√Hz, at the coil", 1e3 * thermal, "mV", "rms behind the anti-alias pole")
    return rows


class Sheet:
    """An SVG in units of 0.177 mm on A4."""

    def __init__(self, width, height):
        self.width, self.height, self.parts = width, height, []

    def add(self, text):
        self.parts.append(text)

    def path(self, d, cls="w"):
        self.add(f'<path class="{cls}" d="{d}"/>')

    def wire(self, *points, cls="w"):
        self.path("M" + " L".join(f"{x:g} {y:g}" for x, y in points), cls)

    def dot(self, x, y):
        self.add(f'<circle class="dot" cx="{x:g}" cy="{y:g}" r="3.4"/>')

    def rect(self, x, y, w, h, cls="s", rx=0):
        self.add(f'<rect class="{cls}" x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="{rx}"/>')

    def text(self, x, y, lines, cls="t", anchor="start", step=15.5):
        for k, line in enumerate(lines.split("\n")):
            self.add(
                f'<text class="{cls}" x="{x:g}" y="{y + k * step:g}" text-anchor="{anchor}">{escape(line)}</text>'
            )

    # Two-terminal symbols between (x, y) and the point `length` to the right ("h") or below ("v").
    def two(self, x, y, length, way, body, draw):
        """Leads around a body; `draw` gets (along, across) -> point."""
        at = (lambda a, b: (x + a, y + b)) if way == "h" else (lambda a, b: (x + b, y + a))
        lead = (length - body) / 2
        self.wire(at(0, 0), at(lead, 0))
        self.wire(at(length - lead, 0), at(length, 0))
        draw(lambda a, b: at(lead + a, b))

    def box(self, at, length, half):
        a, b = at(0, -half), at(length, half)
        self.rect(min(a[0], b[0]), min(a[1], b[1]), abs(a[0] - b[0]), abs(a[1] - b[1]))

    def resistor(self, x, y, length, way, body=36):
        self.two(x, y, length, way, body, lambda at: self.box(at, body, 7))

    def ntc(self, x, y, length, way):
        def draw(at):
            self.box(at, 36, 7)
            self.wire(at(38, -16), at(32, -11), at(4, 11), cls="s")

        self.two(x, y, length, way, 36, draw)

    def varistor(self, x, y, length, way):
        def draw(at):
            self.box(at, 36, 7)
            self.wire(at(40, -14), at(36, -14), at(0, 14), cls="s")

        self.two(x, y, length, way, 36, draw)

    def fuse(self, x, y, length, way):
        def draw(at):
            self.box(at, 40, 7)
            self.wire(at(0, 0), at(40, 0))

        self.two(x, y, length, way, 40, draw)

    def capacitor(self, x, y, length, way):
        def draw(at):
            for a in (0, 7):
                self.wire(at(a, -12), at(a, 12), cls="plate")

        self.two(x, y, length, way, 7, draw)

    def diode(self, x, y, length, way, back=False, schottky=False):
        """Conducts along the way, or back."""

        def draw(at):
            def put(a, b):
                return at(15 - a, b) if back else at(a, b)

            a, b, c = put(0, -8), put(0, 8), put(15, 0)
            self.add(f'<path class="fill" d="M{a[0]:g} {a[1]:g} L{b[0]:g} {b[1]:g} L{c[0]:g} {c[1]:g} Z"/>')
            if schottky:
                self.wire(put(11, -6), put(11, -9), put(15, -9), put(15, 9), put(19, 9), put(19, 6), cls="s")
            else:
                self.wire(put(15, -9), put(15, 9), cls="s")

        self.two(x, y, length, way, 15, draw)

    def coil(self, x, y, length, way, turns=4, side=-1):
        size = 18
        body = turns * size

        def draw(at):
            p = at(0, 0)
            d = f"M{p[0]:g} {p[1]:g}"
            sweep = 1 if (way == "h") == (side < 0) else 0
            for k in range(1, turns + 1):
                q = at(k * size, 0)
                d += f" A{size / 2} {size / 2} 0 0 {sweep} {q[0]:g} {q[1]:g}"
            self.path(d, "s")

        self.two(x, y, length, way, body, draw)

    def igbt(self, x, y):
        """Gate at (x - 45, y), collector at (x, y - 40), emitter at (x, y + 40)."""
        self.wire((x - 45, y), (x - 27, y))
        self.wire((x - 27, y - 20), (x - 27, y + 20), cls="plate")
        self.wire((x - 20, y - 24), (x - 20, y + 24), cls="plate")
        self.wire((x - 20, y - 12), (x, y - 26), (x, y - 40), cls="s")
        self.wire((x - 20, y + 12), (x, y + 26), (x, y + 40), cls="s")
        self.add(f'<path class="fill" d="M{x - 2} {y + 25} l-11 -2.5 l6 -8 Z"/>')

    def opamp(self, x, y, name, plus_up=True):
        """Inputs at (x, y - 20) and (x, y + 20), output at (x + 66, y)."""
        self.add(f'<path class="s" d="M{x} {y - 38} L{x} {y + 38} L{x + 66} {y} Z"/>')
        up, down = ("+", "−") if plus_up else ("−", "+")
        self.text(x + 19, y + 4.5, name, "n")
        self.text(x + 6, y - 15, up, "sign")
        self.text(x + 6, y + 26, down, "sign")

    def ground(self, x, y):
        for k, half in enumerate((12, 8, 4)):
            self.wire((x - half, y + 4 * k), (x + half, y + 4 * k), cls="s")

    def chassis(self, x, y):
        self.wire((x - 15, y), (x + 15, y), cls="plate")
        for k in (-14, -3, 8):
            self.wire((x + k + 6, y), (x + k - 2, y + 11), cls="s")

    def supply(self, x, y, name):
        self.wire((x, y), (x, y - 8))
        self.wire((x - 10, y - 8), (x + 10, y - 8), cls="plate")
        self.text(x, y - 13, name, "net", "middle")

    def terminal(self, x, y):
        self.add(f'<circle class="s" cx="{x:g}" cy="{y:g}" r="5"/>')

    def flag(self, x, y, name, way="right", cls="flag", width=None):
        """A net's name; `way` is where the flag points, the wire ends at its tip's other side."""
        w = width or 14 + 8.6 * len(name)
        h, tip = 11, 9
        if way == "right":
            pts = [(x, y - h), (x + w, y - h), (x + w + tip, y), (x + w, y + h), (x, y + h)]
            tx = x + w / 2 + 1
        else:
            pts = [(x, y - h), (x - w, y - h), (x - w - tip, y), (x - w, y + h), (x, y + h)]
            tx = x - w / 2 - 1
        self.add(f'<path class="{cls}" d="M' + " L".join(f"{a:g} {b:g}" for a, b in pts) + ' Z"/>')
        self.text(tx, y + 4.8, name, "net", "middle")

    def svg(self):
        style = """
text{font-family:'DejaVu Sans',Verdana,Arial,sans-serif;fill:#111}
.t{font-size:13px}.n{font-size:12px;fill:#333}.h{font-size:16px;font-weight:700}
.net{font-size:13px;font-weight:700}.sign{font-size:15px}.warn{font-size:16px;font-weight:700;fill:#fff}
.r{font-size:13px;fill:#b00020;font-weight:700}.rn{font-size:12px;fill:#b00020}
.w,.s,.plate{fill:none;stroke:#111;stroke-width:1.5;stroke-linecap:round;stroke-linejoin:round}
.plate{stroke-width:2.6}.bus{fill:none;stroke:#111;stroke-width:2.6}.fill{fill:#111;stroke:#111;stroke-width:1}
.dot{fill:#111}.flag{fill:#e8f0fb;stroke:#1f4e9c;stroke-width:1.3}.pin{fill:#e3f4e3;stroke:#22702a;stroke-width:1.3}
.later{fill:#f0f0f0;stroke:#777;stroke-width:1.3;stroke-dasharray:4 3}
.frame{fill:none;stroke:#9aa4b2;stroke-width:1}.chip{fill:#fafbfd;stroke:#111;stroke-width:2}
.barrier{fill:none;stroke:#b00020;stroke-width:2.4;stroke-dasharray:9 6}.strip{fill:#b00020}.grey{fill:#f0f0f0;stroke:#777;stroke-dasharray:4 3}
"""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" role="img" '
            'aria-label="Schematic of power stage, gate driver, measuring inputs and controller">'
        )
        body = "\n".join(self.parts)
        return f'{head}\n<style>{style}</style>\n<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'


def pin_cell(s, x, y, capacitor, pin, rise=44):
    """Series resistor, capacitor, clamps, and the pin; 220 wide."""
    s.resistor(x, y, 66, "h")
    s.text(x + 33, y - 12, ohm(PARTS["pin_r"]), "t", "middle")
    s.wire((x + 66, y), (x + 178, y))
    s.dot(x + 80, y)
    s.capacitor(x + 80, y, rise, "v")
    s.ground(x + 80, y + rise)
    s.text(x + 62, y + 27, capacitor, "t", "end")
    s.dot(x + 130, y)
    s.diode(x + 130, y - rise, rise, "v", back=True, schottky=True)
    s.supply(x + 130, y - rise, "3V3")
    s.diode(x + 130, y, rise, "v", back=True, schottky=True)
    s.ground(x + 130, y + rise)
    s.text(x + 146, y + 26, "BAT54S", "n")
    s.flag(x + 178, y, pin, "right", "pin")


def power_stage(s):
    """Mains input to gate driver; the heights of DC+, DC− and SW."""
    top, low, sw = 112, 478, 300
    line, neutral, earth = 205, 345, 440
    s.text(24, 82, "Power stage", "h")
    for y, name in ((line, "L"), (neutral, "N"), (earth, "PE")):
        s.terminal(46, y)
        s.text(46, y - 12, name, "net", "middle")
    s.text(24, 268, "230 V~\n50/60 Hz", "t")
    s.wire((51, earth), (90, earth), (90, earth + 14))
    s.chassis(90, earth + 14)
    s.text(116, earth + 22, "chassis and frame. Never DC−", "n")
    s.wire((51, line), (88, line))
    s.wire((51, neutral), (400, neutral))
    for y, name, up in ((line, "L′", -1), (neutral, "N′", 1)):
        s.dot(72, y)
        s.wire((72, y), (72, y + 34 * up))
        s.flag(72, y + 34 * up, name, "right")
    s.fuse(88, line, 76, "h")
    s.text(126, line + 24, "F1 T 16 A", "t", "middle")
    s.wire((164, line), (400, line))
    s.dot(186, line), s.dot(186, neutral)
    s.varistor(186, line, neutral - line, "v")
    s.text(204, 242, "RV1\n275 V~", "t")
    s.dot(268, line), s.dot(268, neutral)
    s.capacitor(268, line, neutral - line, "v")
    s.text(278, 308, "C1 X2\n0.47 µF", "t")
    s.dot(350, line), s.dot(350, neutral)
    s.resistor(350, line + 12, 58, "v")
    s.resistor(350, line + 70, 58, "v")
    s.wire((350, line), (350, line + 12)), s.wire((350, line + 128), (350, neutral))
    s.text(364, 252, "2 ×\n330 kΩ", "t")
    # Common-mode choke.
    s.coil(400, line, 80, "h", 4, -1)
    s.coil(400, neutral, 80, "h", 4, 1)
    s.wire((404, line - 17), (476, line - 17), cls="s"), s.wire((404, neutral + 17), (476, neutral + 17), cls="s")
    s.text(478, line - 26, "L1 2 × 1 mH, 16 A", "t", "end")
    # Rectifier: the leg of the line, the leg of the neutral.
    a, b = 510, 566
    s.wire((480, line), (a, line)), s.dot(a, line)
    s.wire((480, neutral), (b, neutral)), s.dot(b, neutral)
    for x in (a, b):
        s.diode(x, top, line - top, "v", back=True)
        s.wire((x, line), (x, neutral))
        s.diode(x, neutral, low - neutral, "v", back=True)
        s.dot(x, top), s.dot(x, low)
    s.text(538, low + 20, "BR1 25 A, 1 kV", "t", "middle")
    # DC link.
    s.wire((a, top), (1305, top), cls="bus")
    s.wire((a, low), (1500, low), cls="bus")
    s.text(610, top - 10, "DC+", "net")
    s.text(670, low + 20, "DC− = ground of everything below: LIVE", "r")
    x = 636
    s.dot(x, top), s.dot(x, low)
    s.capacitor(x, top, low - top, "v")
    s.text(x + 16, 266, "C2\n4.7 µF\nfilm\n630 V", "t")
    s.ground(x, low + 10), s.wire((x, low), (x, low + 10))
    x = 726
    s.dot(x, top), s.dot(x, low)
    s.wire((x, top), (x, 320))
    s.resistor(x, 320, 60, "v"), s.resistor(x, 380, 60, "v")
    s.wire((x, 440), (x, low))
    s.text(x - 14, 378, "2 ×\n47 kΩ\n1 W", "t", "end")
    # Gate driver.
    s.rect(890, 195, 110, 255, "chip")
    s.text(945, 330, "U1\n600 V\nhalf-bridge\ndriver", "t", "middle")
    for y, name in ((215, "VCC"), (265, "HIN"), (395, "LIN")):
        s.text(896, y + 5, name, "n")
    for y, name in ((215, "VB"), (255, "HO"), (sw, "VS"), (410, "LO")):
        s.text(994, y + 5, name, "n", "end")
    s.text(945, 444, "COM", "n", "middle")
    s.wire((945, 450), (945, low)), s.dot(945, low)
    s.flag(812, 265, "PA8", "left", "pin"), s.flag(812, 395, "PA9", "left", "pin")
    s.wire((812, 265), (890, 265)), s.wire((812, 395), (890, 395))
    for y in (265, 395):
        s.dot(860, y)
        s.resistor(860, y, 60, "v")
        s.text(848, y + 35, "10 kΩ", "t", "end")
    s.ground(860, 325)
    s.wire((860, 455), (860, low)), s.dot(860, low)
    # Supply and bootstrap.
    s.supply(860, 162, "+15 V")
    s.wire((860, 162), (860, 215), (890, 215)), s.dot(860, 172)
    s.wire((812, 172), (890, 172))
    s.capacitor(812, 172, 44, "v"), s.ground(812, 216)
    s.text(795, 199, "10 µF", "t", "end")
    s.resistor(890, 172, 56, "h")
    s.text(918, 159, "10 Ω", "t", "middle")
    s.diode(946, 172, 60, "h")
    s.text(954, 159, "600 V, 50 ns", "t")
    s.wire((1000, 172), (1040, 172), (1040, 215)), s.wire((1000, 215), (1040, 215))
    s.dot(1040, 215)
    s.capacitor(1040, 215, sw - 215, "v")
    s.text(1054, 252, "1 µF", "t", "start")
    s.text(1054, 268, "25 V", "t", "start")
    s.wire((1000, sw), (1395, sw)), s.dot(1040, sw)
    return top, low, sw


def bridge(s, top, low, sw):
    """Switches, coil, resonance capacitor, current transformer."""
    x = 1190
    s.igbt(x, 205)
    s.wire((x, top), (x, 165)), s.wire((x, 245), (x, sw))
    s.igbt(x, 385)
    s.wire((x, sw), (x, 345)), s.wire((x, 425), (x, low))
    for y in (top, sw, low):
        s.dot(x, y)
    s.text(x + 8, 160, "Q1", "net"), s.text(x + 8, 340, "Q2", "net")
    # HO hops over VB twice.
    s.path("M1000 255 L1020 255 L1020 222 A7 7 0 0 1 1020 208 L1020 190 L1033 190 A7 7 0 0 1 1047 190 L1062 190 L1062 205")
    s.wire((1000, 410), (1020, 410), (1020, 385), (1062, 385))
    for y, end in ((205, sw), (385, low)):
        s.resistor(1062, y, 56, "h")
        s.text(1090, y - 12, "10 Ω", "t", "middle")
        s.wire((1118, y), (x - 45, y))
        s.dot(1126, y), s.dot(1126, end)
        s.wire((1126, y), (1126, y + 24))
        s.resistor(1126, y + 24, 56, "v")
        s.wire((1126, y + 80), (1126, end))
        s.text(1137, y + 64, "10 kΩ", "t")
    for a, b in ((top, sw), (sw, low)):
        s.diode(1245, a, b - a, "v", back=True)
        s.capacitor(1305, a, b - a, "v")
        for xx in (1245, 1305):
            s.dot(xx, a), s.dot(xx, b)
        s.text(1320, (a + b) / 2 - 2, "6.8 nF\n1 kV", "t")
    s.text(1320, top - 18, "Q1, Q2: IGBT 650 V, 40 A, 150 A pulsed,\nfree-wheeling diodes inside", "t")
    # Coil with pot.
    s.dot(1378, sw)
    s.wire((1378, sw), (1378, sw + 34))
    s.flag(1378, sw + 34, "SW", "right")
    s.coil(1395, sw, 105, "h", 5, -1)
    s.wire((1400, sw - 72), (1400, sw - 30), (1494, sw - 30), (1494, sw - 72), cls="plate")
    s.text(1447, sw - 42, "pot", "t", "middle")
    s.text(1510, sw - 62, "coil + pot:\n19–31 µH, 3–9 Ω\ni > 0: SW → X", "t")
    s.dot(1500, sw)
    s.wire((1500, sw), (1540, sw)), s.flag(1540, sw, "X", "right")
    s.capacitor(1500, sw, 80, "v")
    s.text(1520, sw + 36, "C_r 4 × 270 nF\n1 kV, pulse PP", "t")
    # Current transformer at the cold end.
    s.coil(1500, sw + 80, 78, "v", 3, 1)
    s.wire((1500, sw + 158), (1500, low)), s.dot(1500, low)
    for bar in (1522, 1528):
        s.wire((bar, sw + 92), (bar, sw + 146), cls="s")
    s.coil(1550, sw + 80, 78, "v", 3, -1)
    for y, name in ((sw + 80, "CT+"), (sw + 158, "CT−")):
        s.wire((1550, y), (1572, y))
        s.flag(1572, y, name, "right")
    s.dot(1510, sw + 84), s.dot(1540, sw + 84)
    s.text(1572, sw + 124, "T1 1 : 200", "t")


def difference(s, y, title, name, nets, top, bottom, cap, pin_c, pin):
    """A difference amplifier around VREF: VREF + (first net − second) · bottom / chain."""
    x = 24
    s.text(x, y - 98, title, "h")
    s.flag(x + 56, y - 20, nets[0], "left"), s.flag(x + 56, y + 20, nets[1], "left")
    for k in (-20, 20):
        s.resistor(x + 56, y + k, 124, "h", 84)
        s.text(x + 112, y + k + (-12 if k < 0 else 24), top, "t", "middle")
        s.wire((x + 180, y + k), (x + 264, y + k))
        s.dot(x + 204, y + k)
    # The + input to the reference.
    s.resistor(x + 204, y - 74, 54, "v")
    s.text(x + 192, y - 56, bottom, "t", "end")
    s.wire((x + 204, y - 74), (x + 266, y - 74))
    s.flag(x + 266, y - 74, "VREF", "right")
    # The − input to the output.
    s.opamp(x + 264, y, name)
    out = x + 330
    s.wire((out, y), (out + 30, y)), s.dot(out + 14, y)
    s.wire((x + 204, y + 20), (x + 204, y + 66), (x + 256, y + 66))
    s.resistor(x + 256, y + 66, 60, "h")
    s.text(x + 286, y + 56, bottom, "t", "middle")
    s.wire((x + 316, y + 66), (out + 14, y + 66), (out + 14, y))
    if cap:
        s.dot(x + 242, y - 74), s.dot(x + 242, y - 20)
        s.capacitor(x + 242, y - 74, 54, "v")
        s.text(x + 258, y - 44, cap, "t")
        s.dot(x + 236, y + 66), s.dot(x + 328, y + 66)
        s.wire((x + 236, y + 66), (x + 236, y + 92)), s.wire((x + 328, y + 66), (x + 328, y + 92))
        s.capacitor(x + 236, y + 92, 92, "h")
        s.text(x + 338, y + 100, cap, "t")
    pin_cell(s, out + 30, y, pin_c, pin)


def bus_voltage(s, y):
    x = 24
    s.text(x, y - 72, f"Bus, 0…{full_scales()[2]:.0f} V → PB1, ADC3 IN1", "h")
    s.flag(x + 56, y - 20, "DC+", "left")
    s.resistor(x + 56, y - 20, 124, "h", 84)
    s.text(x + 118, y - 32, f"4 × {ohm(PARTS['bus_top'])}", "t", "middle")
    s.wire((x + 180, y - 20), (x + 264, y - 20))
    s.dot(x + 192, y - 20), s.dot(x + 236, y - 20)
    s.resistor(x + 192, y - 20, 62, "v"), s.ground(x + 192, y + 42)
    s.text(x + 180, y + 16, ohm(PARTS["bus_bottom"]), "t", "end")
    s.capacitor(x + 236, y - 20, 62, "v"), s.ground(x + 236, y + 42)
    s.text(x + 234, y + 66, farad(PARTS["bus_c"]), "t", "middle")
    s.opamp(x + 264, y, "U4B")
    follow(s, x + 264, y, x + 344)
    pin_cell(s, x + 360, y, farad(PARTS["pin_c_slow"]), "PB1")


def follow(s, x, y, corner):
    """Wires a follower's output back to its − input, below."""
    s.wire((x + 66, y), (corner + 16, y)), s.dot(corner, y)
    s.wire((corner, y), (corner, y + 54), (x - 10, y + 54), (x - 10, y + 20), (x, y + 20))


def current(s, y):
    x = 668
    s.text(x, y - 74, f"Coil current, ±{full_scales()[3]:.1f} A → PA1, inverted → PA7", "h")
    s.flag(x + 56, y, "CT+", "left"), s.flag(x + 56, y + 62, "CT−", "left")
    s.wire((x + 56, y), (966, y)), s.wire((x + 56, y + 62), (x + 100, y + 62), (x + 100, y + 94), (x + 72, y + 94))
    s.flag(x + 72, y + 94, "VREF", "left")
    s.dot(x + 100, y), s.dot(x + 100, y + 62)
    s.resistor(x + 100, y, 62, "v")
    s.text(x + 113, y + 28, ohm(PARTS["burden"]) + "\n1 W, 0.1 %", "t")
    pin_cell(s, 966, y, farad(PARTS["pin_c_fast"]), "PA1")
    # The inverter around VREF.
    low = y + 178
    s.dot(880, y)
    s.wire((880, y), (880, y + 92), (780, y + 92), (780, low - 20))
    s.resistor(780, low - 20, 74, "h")
    s.text(817, low - 32, "10 kΩ", "t", "middle")
    s.wire((854, low - 20), (880, low - 20)), s.dot(862, low - 20)
    s.opamp(880, low, "U3B", plus_up=False)
    s.wire((880, low + 20), (852, low + 20)), s.flag(852, low + 20, "VREF", "left")
    s.wire((946, low), (966, low)), s.dot(956, low)
    s.wire((862, low - 20), (862, low - 62), (880, low - 62))
    s.resistor(880, low - 62, 60, "h")
    s.text(910, low - 74, "10 kΩ", "t", "middle")
    s.wire((940, low - 62), (956, low - 62), (956, low))
    pin_cell(s, 966, low, farad(PARTS["pin_c_fast"]), "PA7")


def reference(s, y):
    x = 668
    s.text(x, y - 54, "Mid-scale, 1.65 V", "h")
    s.supply(x + 20, y - 12, "VDDA")
    s.wire((x + 20, y - 12), (x + 20, y - 6))
    s.resistor(x + 20, y - 6, 56, "v"), s.resistor(x + 20, y + 50, 56, "v"), s.ground(x + 20, y + 106)
    s.dot(x + 20, y + 50)
    s.text(x + 32, y + 27, "10 kΩ", "t"), s.text(x + 32, y + 98, "10 kΩ", "t")
    s.wire((x + 20, y + 50), (x + 130, y + 50)), s.dot(x + 98, y + 50)
    s.capacitor(x + 98, y + 50, 56, "v"), s.ground(x + 98, y + 106)
    s.text(x + 82, y + 132, "100 nF", "t", "middle")
    s.opamp(x + 130, y + 70, "U5A")
    follow(s, x + 130, y + 70, x + 210)
    s.flag(x + 226, y + 70, "VREF", "right")


def thermistors(s, y):
    s.text(968, y - 54, "NTCs on ADC4", "h")
    for k, (sensor, (r25, b_k, pull_up)) in enumerate(NTCS.items()):
        where, ntc, up = sensor.replace("_", " "), f"{ohm(r25)}\nB {b_k}", ohm(pull_up)
        x = 986 + 84 * k
        s.supply(x, y - 12, "3V3")
        s.wire((x, y - 12), (x, y - 6))
        s.resistor(x, y - 6, 56, "v"), s.ntc(x, y + 50, 56, "v"), s.ground(x, y + 106)
        s.text(x + 12, y + 18, up, "t")
        s.dot(x, y + 50)
        s.flag(x + 8, y + 50, BOARD["pins"][f"{sensor}_ntc"], "right", "pin", 46), s.wire((x, y + 50), (x + 8, y + 50))
        s.text(x - 12, y + 134, where + "\n" + ntc, "n")


def controller(s):
    x, y, w, h = 1262, 556, 172, 356
    edge = x + w
    s.rect(x, y, w, h, "chip")
    s.text(x, y - 12, "U2 STM32G474RE", "h")
    left = (
        ("PA0", "ADC1"), ("PA1", "ADC2, COMP1"), ("PA7", "COMP2"), ("PB1", "ADC3"), ("PB0", "ADC3"),
        ("PA8", "HRTIM A1"), ("PA9", "HRTIM A2"),
    )  # fmt: skip
    for k, (pin, what) in enumerate(left):
        at = y + 24 + 29 * k + (14 if k > 4 else 0)
        s.flag(x - 55, at, pin, "right", "pin", 30)
        s.wire((x - 16, at), (x, at))
        s.text(x + 6, at + 5, what, "n")
    at = y + 262
    s.flag(x - 79, at, "NTCs", "right", "pin", 54), s.wire((x - 16, at), (x, at))
    s.text(x + 6, at + 5, "ADC4", "n")
    # nSWBOOT0 = 1 leaves the choice to the pin, and the bootloader drives HIN and LIN.
    at = y + 302
    s.resistor(x - 64, at, 64, "h"), s.wire((x - 64, at), (x - 72, at), (x - 72, at + 6)), s.ground(x - 72, at + 6)
    s.text(x - 32, at - 11, "10 kΩ", "t", "middle"), s.text(x + 6, at + 5, "PB8, BOOT0", "n")
    s.text(x + 6, y + h - 10, "VSS, VSSA", "n")
    s.wire((x + 34, y + h), (x + 34, y + h + 8)), s.ground(x + 34, y + h + 8)
    led = BOARD["pins"]["led"]
    pins = {"PA2": 24, "PA3": 52, "PA12": 96, "PA11": 124, led: 204, "NRST": 242, "VDDA": 290, "VDD": 334}
    for pin in pins:
        pins[pin] += y
        s.text(edge - 6, pins[pin] + 5, pin, "n", "end")
    # Serial port and USB, with the isolation that a computer needs.
    for pin, way in (("PA2", "TX"), ("PA3", "RX"), ("PA12", "D+"), ("PA11", "D−")):
        s.wire((edge, pins[pin]), (1478, pins[pin]))
        s.text(edge + 8, pins[pin] - 5, way, "n")
    barrier = 1603
    for top, name in ((pins["PA2"] - 16, "ST-LINK:\nserial,\nSWD"), (pins["PA12"] - 16, "USB\nsocket")):
        lines = name.count("\n")
        s.rect(1478, top, 70, 60, "s")
        s.text(1513, top + 41 - 10 * lines, name, "n", "middle", 15)
        s.wire((1548, top + 30), (1572, top + 30)), s.rect(1572, top, 62, 60, "s")
        s.text(barrier, top + 20, "USB\nisolator\n5 kV", "n", "middle", 15)
        s.wire((1634, top + 30), (1645, top + 30)), s.text(1647, top + 34, "PC", "n")
        s.wire((barrier, top - 16), (barrier, top), cls="barrier")
    s.wire((barrier, pins["PA11"] + 16), (barrier, pins["PA11"] + 30), cls="barrier")
    s.text(barrier - 8, y - 12, "live", "r", "end"), s.text(barrier + 8, y - 12, "safe", "t")
    s.text(1444, pins["PA11"] + 34, "USB: a NUCLEO has no\nsocket for it; wire one", "n", step=14)
    # LED.
    at = pins[led]
    s.wire((edge, at), (1470, at)), s.resistor(1470, at, 56, "h"), s.diode(1526, at, 50, "h")
    s.wire((1576, at), (1600, at), (1600, at + 8)), s.ground(1600, at + 8)
    s.text(1498, at + 23, "510 Ω", "t", "middle")
    for k in (0, 9):
        s.wire((1550 + k, at - 11), (1559 + k, at - 21), cls="s")
    s.text(1534, at + 23, "LD2", "t")
    # Reset.
    at = pins["NRST"]
    s.wire((edge, at), (1620, at)), s.dot(1452, at)
    s.capacitor(1452, at, 28, "v"), s.ground(1452, at + 28)
    s.text(1468, at + 22, "100 nF", "t")
    s.text(1620, at + 18, "ST-LINK, button", "n", "end")
    # Supplies of the chip.
    at, below = pins["VDDA"], pins["VDD"]
    s.wire((edge, at), (1500, at)), s.dot(1470, at)
    s.capacitor(1470, at, 26, "v"), s.ground(1470, at + 26)
    s.text(1486, at + 24, "1 µF", "t"), s.text(1536, at + 24, "ferrite", "n", "middle")
    s.coil(1500, at, 70, "h", 3, -1)
    s.wire((1570, at), (1600, at), (1600, below)), s.dot(1600, below)
    s.wire((edge, below), (1630, below)), s.supply(1630, below, "3V3")
    return y + h


def supplies(s):
    y = 958
    s.rect(1310, y, 110, 76, "s")
    s.text(1365, y + 20, "auxiliary\nsupply\n(bench:\nisolated)", "n", "middle", 15)
    s.wire((1420, y + 22), (1450, y + 22)), s.supply(1450, y + 22, "+15 V")
    s.wire((1420, y + 54), (1540, y + 54)), s.dot(1505, y + 54)
    s.wire((1505, y + 54), (1505, y + 22)), s.supply(1505, y + 22, "+5 V")
    s.rect(1540, y + 34, 62, 42, "s")
    s.text(1571, y + 52, "3.3 V\nLDO", "n", "middle", 15)
    s.wire((1602, y + 54), (1630, y + 54), (1630, y + 22)), s.supply(1630, y + 22, "3V3")
    for x in (1365, 1571):
        s.wire((x, y + 76), (x, y + 84)), s.ground(x, y + 84)


def legend(s):
    y = 1092
    s.text(668, y, "Notes", "h")
    notes = (
        "Chains: 4 resistors 1206, 0.1 %, 200 V each. U3–U5: OPA2365 on +5 V, one half spare, 100 nF each.\n"
        "316 Ω ± 1 % and 1 nF C0G ± 2 % are the anti-alias pole, 503.7 kHz, the same in both channels.\n"
        "Blue: nets. Green: pins that the firmware reads or drives today.\n"
        "Arithmetic, errors and what they mean: docs/board.md. Mains parts: a start, no EMC design."
    )
    s.text(668, y + 20, notes, "n", step=17)
    s.rect(1310, 1082, 354, 90, "s")
    s.text(1322, 1106, "ihd: wiring of the controller board", "h")
    s.text(1322, 1128, "Computed, neither built nor measured:\nno board was at hand.", "t", step=17)
    s.text(1322, 1164, "drawn by docs/schematic.py", "n")


def main_sheet():
    s = Sheet(1680, 1188)
    s.rect(8, 8, 1664, 1172, "frame")
    s.rect(8, 8, 1664, 44, "strip")
    warning = "DANGER: DC− is live. Every node here, serial port, USB and SWD too, is at mains potential. Isolate before you connect a computer or a scope."
    s.text(840, 36, warning, "warn", "middle")
    bridge(s, *power_stage(s))
    p, (coil, mains, _, _) = PARTS, full_scales()
    fast, slow = farad(p["pin_c_fast"]), farad(p["pin_c_slow"])
    coil_top = f"3 × {p['coil_top'] / 1e3:g} + {ohm(p['coil_last'])}"
    title = f"Coil voltage, ±{coil:.1f} V → PA0, ADC1 IN1"
    difference(s, 632, title, "U3A", ("SW", "X"), coil_top, ohm(p["coil_bottom"]), None, fast, "PA0")
    title = f"Mains, ±{mains:.1f} V → PB0, ADC3 IN12"
    shunt = farad(p["mains_c"])
    difference(s, 838, title, "U4A", ("L′", "N′"), f"4 × {ohm(p['mains_top'])}", ohm(p["mains_bottom"]), shunt, slow, "PB0")
    bus_voltage(s, 1060)
    current(s, 612)
    reference(s, 920)
    thermistors(s, 920)
    controller(s)
    supplies(s)
    legend(s)
    return s


if __name__ == "__main__":
    sheet = main_sheet().svg()
    if "--check" in sys.argv:
        sys.exit(0 if OUT.read_text() == sheet else f"{OUT} is not what {__file__} writes")
    OUT.write_text(sheet)
    for name, number, unit, how in values():
        print(f"{name:48} {number:10.4g} {unit:5} {how}")
