"""Contacts in printers' files of Klipper, each left out once: who predicts it.

The files are their owners' and not here. FOLDER has a ``printer.cfg`` or more of each printer,
under any names, with the block that SAVE_CONFIG wrote. Of a file the contacts are read, steps below
the switches, and the geometry from which its owner began: what SAVE_CONFIG put behind a #. The
switches are taken at the height at which the contacts are at the plate on average. The same
contacts in several files count once. Fits and misses are those of `tests.blind.public_contacts`.

    python -m tests.blind.saved_contacts FOLDER
"""

from __future__ import annotations

import math
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.app.exports.upright_towers import outward
from tests.blind.printers import FloatArray
from tests.blind.public_contacts import Fit, Printer, rms

LINE = re.compile(r"(#\*#|#)?\s*(\w+)\s*[:=]\s*([-+.\d]+(?:,[-+.\d]+)*)")

USUAL_DEG = {"a": 210.0, "b": 330.0, "c": 90.0}

Keys = dict[tuple[str, str], str]


@dataclass(frozen=True)
class SavedFile:
    """Numbers by section and key: in front of the saved block, also behind #, and in it."""

    begun: Keys
    saved: Keys

    @classmethod
    def read(cls, text: str) -> SavedFile:
        """Of a file's text."""
        kinds: dict[str, Keys] = {"": {}, "#": {}, "#*#": {}}
        section = ""
        for line in text.splitlines():
            header = re.match(r"(?:#\*#)?\s*\[(.+?)\]", line)
            section = header[1] if header else section
            if match := LINE.match(line):
                kinds[match[1] or ""].setdefault((section, match[2]), match[3])
        return cls(kinds["#"] | kinds[""], kinds["#*#"])

    def of_towers(self, key: str, usual: float | None = None) -> FloatArray:
        """A key of every tower ``(3,)``; Klipper takes that of the first where one has none."""
        spare = self.begun["stepper_a", key] if usual is None else usual
        values = [self.begun.get((f"stepper_{tower}", key), spare) for tower in USUAL_DEG]
        return np.array(values, float)

    def printer(self) -> Printer:
        """Raises KeyError where it is no delta with saved contacts, ValueError for unlike bars."""
        (bar_mm,) = set(self.of_towers("arm_length").tolist())
        radius_mm = float(self.begun["printer", "delta_radius"])
        angles = np.array(
            [self.begun.get((f"stepper_{t}", "angle"), usual) for t, usual in USUAL_DEG.items()],
            float,
        )
        turn = self.of_towers("full_steps_per_rotation", 200.0) * self.of_towers("microsteps")
        texts = [v for (_, key), v in self.saved.items() if re.fullmatch(r"height\d+_pos", key)]
        steps = np.array([text.split(",") for text in texts], float)
        below_mm = steps * self.of_towers("rotation_distance") / turn
        stop_mm = float(self.of_towers("position_endstop").mean())
        trip_mm = stop_mm + math.sqrt(bar_mm**2 - radius_mm**2)
        feet_mm = radius_mm * outward(angles)
        places = np.array([met(feet_mm, trip_mm - each_mm, bar_mm) for each_mm in below_mm])
        zero_mm = float(places[:, 2].mean())
        level = tuple(places - [0.0, 0.0, zero_mm])
        return Printer((stop_mm - zero_mm,) * 3, radius_mm, angles, bar_mm, level)


def met(feet_mm: FloatArray, carriage_mm: FloatArray, bar_mm: float) -> FloatArray:
    """Where the tool is below carriages at these heights ``(3,)``: where three spheres meet."""
    joints = np.column_stack([feet_mm, carriage_mm])
    place = np.array([0.0, 0.0, carriage_mm.min() - 0.8 * bar_mm])
    for _ in range(30):
        way = place - joints
        place = place - np.linalg.solve(2.0 * way, (way**2).sum(axis=1) - bar_mm**2)
    return place


def main() -> None:
    totals: list[list[float]] = []
    known: set[bytes] = set()
    print("| file | uncalibrated | six factors | glidecal |")
    for path in sorted(Path(sys.argv[1]).rglob("*.cfg")):
        try:
            printer = SavedFile.read(path.read_text("utf-8", "replace")).printer()
            contacts = np.array(printer.contacts).tobytes()
            if contacts in known:
                continue
            known.add(contacts)
            fits: tuple[Fit, ...] = (printer.uncalibrated, printer.six, printer.ours)
            totals.append([rms(printer.missed_mm(fit)) for fit in fits])
        except (AssertionError, KeyError, ValueError) as problem:  # another kind, or refused
            print(f"{path.name}: not used, {problem}", file=sys.stderr)
            continue
        print(f"| {path.stem} | {' | '.join(f'{mm:.3f}' for mm in totals[-1])} |", flush=True)
    for word, row in (("r.m.s.", rms), ("median", np.median)):
        cells = " | ".join(f"{row(column):.3f}" for column in np.array(totals).T)
        print(f"| {word} of {len(totals)} | {cells} |")


if __name__ == "__main__":
    main()
