"""What RepRapFirmware, Marlin and Repetier hold and answer on a true machine, line by line."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from tests.app.exports import upright_towers as true
from tests.protocols.printers.printers import PERFECT, rings, touched_at

HEIGHT = 300.0
STOPS = [stop - HEIGHT for stop in true.ENDSTOPS]


def words(values: Sequence[float], letters: str = "XYZ") -> str:
    return " ".join(f"{letter}{value:.3f}" for letter, value in zip(letters, values, strict=True))


CONFIG_G = f"""\
; general
M550 P"mine"                    ; a name
M665 L{true.BAR}:{true.BAR}:{true.BAR} R{true.RADIUS} H{HEIGHT} B100 X0 Y0 Z0 ; as measured
M666 {words(STOPS)} A0.00 B0.00
G31 P500 X0 Y0 Z0.25            ; trigger
"""


def g32(hidden: true.Hidden, cycles: int = 1, trigger_mm: float = 0.25) -> tuple[str, str]:
    """A macro with its places, and the answers: where the tool was as the probe tripped."""
    macro = "".join(
        f"G30 P{k} X{x:.3f} Y{y:.3f} Z-99999{' S-1' if k == 18 else ''}\n"
        for k, (x, y) in enumerate(rings())
    )
    heights = [touched_at(hidden, x, y, trigger_mm)[2] - trigger_mm for x, y in rings()]
    answer = "G32 bed probe heights: " + " ".join(f"{height:.3f}" for height in heights)
    lines = f"12:01:02 {answer}, mean 0.001, deviation from mean 0.100\n"
    return macro, lines * cycles


def m503(hidden: true.Hidden, cycles: int = 1) -> str:
    """What Marlin shows and answers; its probe is 15 mm beside the tool and trips 2 mm early."""
    adjusted = [-stop for stop in STOPS]
    lines = [
        "echo:; Endstop adjustment:",
        "echo:  M92 X80.00 Y80.00 Z80.00 E93.00",
        f"echo:  M666 {words(adjusted)}",
        f"echo:  M665 L{true.BAR:.2f} R{true.RADIUS:.2f} H{HEIGHT:.2f} S200.00 X0.00 Y0.00 Z0.00 "
        "A0.00 B0.00 C0.00",
        "echo:  M851 X15.00 Y-5.00 Z-2.00 ; (mm)",
    ]
    for _ in range(cycles):
        for x, y in rings():
            height = touched_at(hidden, x, y, 2.0)[2] - 2.0
            lines += ["ok", f"Bed X: {x + 15.0:.2f} Y: {y - 5.0:.2f} Z: {height:.2f}"]
    return "\n".join(lines) + "\n"


G33_AT_DEG = {"x": 210.0, "y": 330.0, "z": 90.0, "yz": 30.0, "zx": 150.0, "xy": 270.0}


def g33(
    hidden: true.Hidden,
    places: int = 3,
    sent: str = "G33 P3 V0",
    mode: str = " (DRY-RUN)",
    radius: str = " at radius:80.00",
) -> str:
    """Sent and answered as a host shows it: `probe_calibration_points` and what prints it.

    The tool goes to the places; the probe of `m503` trips 2 mm early wherever it is beside.
    """

    def height(radius_mm: float, *angles_deg: float) -> float:
        heights = [
            touched_at(hidden, radius_mm * math.cos(angle), radius_mm * math.sin(angle), 2.0)[2]
            for angle in np.radians(angles_deg).tolist()
        ]
        return float(np.mean(heights)) - 2.0

    middle = height(8.0, 90.0, 330.0, 210.0) if places == 3 else height(0.0, 0.0)
    heights_by_name = {"c": middle} | {
        name: height(80.0, angle) for name, angle in G33_AT_DEG.items()
    }
    first = [
        f"{'c'}:{heights_by_name['c']:+.2f}",
        *(f" {name}:{heights_by_name[name]:+.2f}" for name in "xyz"),
    ]
    second = [f"{name}:{heights_by_name[name]:+.2f}" for name in ("yz", "zx", "xy")]
    table = {
        1: f".      {first[0]}",
        2: f".      {'  '.join(first)}",
        3: f".      {'  '.join(first)}\nRecv: .               {'  '.join(second)}",
    }[places]
    lines = (
        "G33 Auto Calibrate",
        f"Checking... AC{radius}{mode}",
        f".Height:{HEIGHT:.2f}  Ex:-0.40  Ey:-0.60  Ez:-0.10  Radius:{true.RADIUS:.2f}",
        ".               Tx:+0.05  Ty:-0.03  Tz:-0.02",
        table,
        "End DRY-RUN                                   std dev:0.123",
    )
    return f"Send: N7 {sent}*35\n" + "".join(f"Recv: {line}\n" for line in lines)


def held_by_marlin() -> str:
    """M503 without an answer of G30."""
    return "".join(line for line in m503(PERFECT).splitlines(True) if "Bed" not in line)


EEPROM = {
    11: (80.0, "Steps per mm"),
    153: (299.0, "Z max length [mm]"),
    881: (true.BAR, "Diagonal rod length [mm]"),
    885: (true.RADIUS, "Horizontal rod radius at 0,0 [mm]"),
    925: (100.0, "Max printable radius [mm]"),
    893: (round((true.ENDSTOPS[0] - 299.0) * 80), "Tower X endstop offset [steps]"),
    895: (round((true.ENDSTOPS[1] - 299.0) * 80), "Tower Y endstop offset [steps]"),
    897: (round((true.ENDSTOPS[2] - 299.0) * 80), "Tower Z endstop offset [steps]"),
    901: (210.0, "Alpha A(210):"),
    905: (330.0, "Alpha B(330):"),
    909: (90.0, "Alpha C(90):"),
}


def m205(hidden: true.Hidden, cycles: int = 1, extra: str = "") -> str:
    lines = [f"11:26:45.077 : EPR:3 {k} {value:.3f} {name}" for k, (value, name) in EEPROM.items()]
    for _ in range(cycles):
        for x, y in rings():
            down = 3.0 - touched_at(hidden, x, y)[2]
            lines.append(f"09:23:25.257 : Z-probe:{down:.3f} X:{x:.2f} Y:{y:.2f}")
    return "\n".join(lines) + f"\n{extra}"


TEN = (
    *((0.00, 70.00, 1.860), (60.62, 35.00, 1.650), (60.62, -35.00, 2.327), (0.00, -70.00, 1.553)),
    *((-60.62, -35.00, 1.247), (-60.62, 35.00, 1.900), (0.00, 35.00, 2.150)),
    *((30.31, -17.50, 2.303), (-30.31, -17.50, 2.120), (0.00, 0.00, 2.327)),
)
"""X, Y and the way down of ten contacts of that printer."""


def real_eeprom() -> str:
    """What that printer held, and its contacts: figures of its owner."""
    stored = {
        **{11: "100.0000 Steps per mm", 153: "275.380 Z max length [mm]"},
        **{881: "203.450 Diagonal rod length [mm]", 925: "85.000 Max printable radius [mm]"},
        **{885: "96.520 Horizontal rod radius at 0,0 [mm]", 893: "0 Tower X endstop offset"},
        **{895: "53 Tower Y endstop offset [steps]", 897: "171 Tower Z endstop offset [steps]"},
        **{901: "207.040 Alpha A(210):", 905: "326.630 Alpha B(330):", 909: "90.000 Alpha C(90):"},
    }
    lines = [f'"11:26:45.015 : EPR:3 {place} {text}",' for place, text in stored.items()]
    lines += [f"09:23:25.257 : Z-probe:{down:.3f} X:{x:.2f} Y:{y:.2f}" for x, y, down in TEN]
    return "\n".join(lines)
