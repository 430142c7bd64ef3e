#!/usr/bin/env python3
"""Draws docs/bring-up-*.svg: what is plugged where at each stage of docs/bring-up.md. Standard library only.

    python3 docs/bring_up.py            # writes the pictures
    python3 docs/bring_up.py --check    # fails if they are not what this writes
"""

import sys
from pathlib import Path
from xml.sax.saxutils import escape

DOCS = Path(__file__).resolve().parent

STYLE = """
text{font-family:'DejaVu Sans',Verdana,Arial,sans-serif;fill:#111}
.h{font-size:17px;font-weight:700}.b{font-size:14px;font-weight:700}.t{font-size:12.5px}.n{font-size:12px;fill:#444}
.r{font-size:13px;fill:#b00020;font-weight:700}
.box{fill:#fafbfd;stroke:#111;stroke-width:1.6}.board{fill:#e3f4e3;stroke:#22702a;stroke-width:1.8}
.low{fill:#e8f0fb;stroke:#1f4e9c;stroke-width:1.6}.hot{fill:#fdecec;stroke:#b00020;stroke-width:1.8}
.out{fill:#f0f0f0;stroke:#777;stroke-width:1.3;stroke-dasharray:5 4}
.w{fill:none;stroke:#111;stroke-width:1.8}.p{fill:none;stroke:#b00020;stroke-width:2.6}
.s{fill:none;stroke:#1f4e9c;stroke-width:1.8}
.barrier{fill:none;stroke:#b00020;stroke-width:2.4;stroke-dasharray:9 6}.pin{fill:#111}
"""


class Sheet:
    """A picture: boxes, wires, words."""

    def __init__(self, width, height, title):
        self.width, self.height, self.title, self.parts = width, height, title, []
        self.text(24, 34, title, "h")

    def text(self, x, y, words, cls="t", anchor="start"):
        for n, line in enumerate(words.split("\n")):
            self.parts.append(
                f'<text class="{cls}" x="{x:g}" y="{y + 17 * n:g}" text-anchor="{anchor}">{escape(line)}</text>'
            )

    def box(self, x, y, w, h, name, words="", cls="box"):
        self.parts.append(f'<rect class="{cls}" x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}" rx="6"/>')
        self.text(x + w / 2, y + 22, name, "b", "middle")
        if words:
            self.text(x + w / 2, y + 42, words, "t", "middle")

    def wire(self, *points, cls="w", name="", at=None, anchor="middle"):
        d = "M" + " L".join(f"{x:g} {y:g}" for x, y in points)
        self.parts.append(f'<path class="{cls}" d="{d}"/>')
        for x, y in (points[0], points[-1]):
            self.parts.append(f'<circle class="pin" cx="{x:g}" cy="{y:g}" r="3"/>')
        if name:
            x, y = at or ((points[0][0] + points[1][0]) / 2, (points[0][1] + points[1][1]) / 2 - 7)
            self.text(x, y, name, "n", anchor)

    def svg(self):
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" width="{self.width}" '
            f'height="{self.height}" role="img" aria-label="{escape(self.title)}">'
        )
        body = "\n".join(self.parts)
        return f'{head}\n<style>{STYLE}</style>\n<rect width="100%" height="100%" fill="#fff"/>\n{body}\n</svg>\n'


def logic():
    """Stage 1 and 2: the NUCLEO alone."""
    s = Sheet(940, 330, "1  Logic alone: one USB cable, nothing else")
    s.box(30, 90, 170, 110, "computer", "ihd flash\nihd log\nihd doctor", "low")
    s.box(330, 70, 580, 220, "NUCLEO-G474RE", "", "board")
    s.box(350, 105, 130, 76, "ST-LINK", "probe and\nserial port")
    s.box(560, 105, 130, 76, "STM32G474", "firmware")
    s.wire((200, 143), (350, 143), cls="s", name="USB", at=(270, 134))
    s.wire((480, 130), (560, 130), name="SWD", at=(520, 124))
    s.wire((480, 160), (560, 160), name="PA2, PA3", at=(520, 177))
    s.wire((690, 125), (745, 125))
    s.text(752, 122, "PA0, PA1, PA7, PB0", "t")
    s.text(752, 139, "to 1.65 V", "n")
    s.wire((690, 165), (745, 165))
    s.text(752, 169, "PB1 to ground", "t")
    s.text(350, 220, "1.65 V: 1 kΩ to 3V3, 1 kΩ to ground, 100 nF. Floating inputs trip protection.", "t")
    s.text(350, 243, "Fault 10, no mains, is right here: the detector at PB0 sees no crossings.", "t")
    s.text(350, 266, "A generator of 50 Hz, 1.65 V ± 0.5 V at PB0 ends it.", "t")
    s.text(30, 315, "No mains, no supply but USB: the only stage without an isolator.", "n")
    return s


def bench():
    """Stage 3 and 4: first switching from a bench supply."""
    s = Sheet(1000, 560, "2  First switching: bench supply of 30 to 60 V, limit 1 A")
    s.box(30, 90, 150, 100, "computer", "ihd doctor\n--first-switching", "low")
    s.box(230, 100, 110, 80, "USB isolator", "5 kV test")
    s.wire((180, 140), (230, 140), cls="s"), s.wire((340, 140), (400, 140), cls="s")
    s.box(400, 80, 210, 130, "NUCLEO-G474RE", "PA8 HIN, PA9 LIN\nPA0 v, PA1 and PA7 i\nPB1 bus, PB0 mains", "board")
    s.box(400, 270, 210, 120, "power stage", "docs/board.md\nF1 is OUT", "hot")
    s.wire((430, 210), (430, 270), name="HIN, LIN", at=(423, 245), anchor="end")
    s.wire((570, 210), (570, 270), name="v, i, bus, mains", at=(563, 245), anchor="end")
    s.box(30, 270, 180, 120, "DC supply", "30 to 60 V, limit 1 A\nisolated output", "hot")
    s.wire((210, 305), (400, 305), cls="p", name="DC+", at=(305, 297))
    s.wire((210, 360), (400, 360), cls="p", name="DC−", at=(305, 352))
    s.box(30, 430, 180, 80, "24 V~ transformer", "the zero crossings")
    s.wire((210, 455), (470, 455), (470, 390), name="L", at=(340, 448))
    s.wire((210, 490), (540, 490), (540, 390), name="N", at=(340, 483))
    s.box(720, 270, 240, 120, "coil, and a pot on it", "through T1, with C_r\nferromagnetic, 21 cm,\nwith water", "box")
    s.wire((610, 305), (720, 305), cls="p", name="SW", at=(665, 297))
    s.wire((610, 360), (720, 360), cls="p", name="X", at=(665, 352))
    s.box(720, 80, 240, 130, "aux supplies", "15 V 0.3 A: gate driver\n5 V 0.5 A: amplifiers\nisolated outputs", "low")
    s.wire((840, 210), (840, 240), (590, 240), (590, 270))
    s.wire((285, 70), (285, 100), cls="barrier"), s.wire((285, 180), (285, 230), cls="barrier")
    s.text(30, 540, "The controller's ground is DC−. Above 60 V it is dangerous to touch, and ihd doctor refuses to switch.", "r")
    return s


def dummy():
    """Stage 5: deskew and calibration."""
    s = Sheet(1000, 400, "3  Deskew: a load that is known, and a scope beside it")
    s.box(30, 80, 210, 120, "power stage", "as in 2:\n40 V, limit 1 A", "hot")
    s.box(420, 80, 250, 120, "dummy load", "air coil, 25 to 35 µH,\nand 4.7 Ω, 50 W in series", "box")
    s.wire((240, 115), (420, 115), cls="p", name="SW", at=(330, 107))
    s.wire((240, 165), (420, 165), cls="p", name="X (C_r, T1)", at=(295, 157))
    s.box(740, 80, 230, 120, "LCR meter, before", "R and L of the load at\n10 kHz or more, unplugged", "low")
    s.wire((670, 140), (740, 140), cls="s")
    s.box(420, 250, 250, 110, "oscilloscope", "differential probe: SW − X\ncurrent probe: coil", "box")
    s.wire((350, 115), (350, 285), (420, 285), cls="s"), s.wire((380, 165), (380, 325), (420, 325), cls="s")
    s.text(30, 270, "The board's channels:\nihd doctor DEV --first-switching\n  --reference r=OHM,l=HENRY", "t")
    s.text(700, 285, "The scope's probes:\nihd calibrate empty.csv\n  --reference no-pot,r=OHM,l=HENRY", "t")
    return s


SHEETS = {"bring-up-1.svg": logic, "bring-up-2.svg": bench, "bring-up-3.svg": dummy}


def main():
    check = sys.argv[1:] == ["--check"]
    for name, draw in SHEETS.items():
        path, svg = DOCS / name, draw().svg()
        if not check:
            path.write_text(svg)
        elif not path.exists() or path.read_text() != svg:
            sys.exit(f"{path} is not what docs/bring_up.py writes: run it")


if __name__ == "__main__":
    main()
