"""Contacts in printers' files of Klipper, each left out once: who predicts it.

The files are their owners' and not here. FOLDER has a ``printer.cfg`` or more of each printer,
under any names, with the block that SAVE_CONFIG wrote. Of a file the contacts are read, steps below
the switches, and the geometry from which its owner began: what SAVE_CONFIG put behind a #. The
switches are taken at the height at which the contacts are at the plate on average. The peer is
Klipper's fit of six factors (switches, a radius, two angles). What a fit misses is the height of
the tool over the plate in the contact that is left out, less the mean of the others. The same
contacts in several files count once.

    python -m tests.blind.saved_contacts FOLDER
"""

from __future__ import annotations

import re
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from tests.app.cli import run_here
from tests.blind.printers import FloatArray
from tests.blind.public_contacts import rms

LINE = re.compile(r"(#\*#|#)?\s*(\w+)\s*[:=]\s*([-+.\d]+(?:,[-+.\d]+)*)")
USUAL_DEG = (210.0, 330.0, 90.0)


@dataclass(frozen=True, eq=False)
class Delta:
    """What Klipper holds of a printer: heights of switches, bars, radius, angles of towers."""

    stop_mm: FloatArray
    bar_mm: FloatArray
    radius_mm: float
    angle_deg: FloatArray

    def height_mm(self, below_mm: FloatArray) -> float:
        """Of the tool, with carriages ``(3,)`` below their switches: where three spheres meet."""
        angle = np.radians(self.angle_deg)
        top = self.stop_mm + np.sqrt(self.bar_mm**2 - self.radius_mm**2) - below_mm
        across = self.radius_mm * np.array([np.cos(angle), np.sin(angle)])
        feet = np.vstack([across, top]).T
        place = np.array([0.0, 0.0, top.min() - 0.8 * self.bar_mm.max()])
        for _ in range(30):
            way = place - feet
            place = place - np.linalg.solve(2.0 * way, (way**2).sum(axis=1) - self.bar_mm**2)
        return float(place[2])

    def before(self, _contacts: FloatArray) -> Delta:
        """Not calibrated."""
        return self

    def six(self, contacts: FloatArray) -> Delta:
        """Klipper's fit to contacts ``(n, 3)``."""

        def changed(by: FloatArray) -> Delta:
            turned = self.angle_deg + np.append(by[4:], 0.0)
            return Delta(self.stop_mm + by[:3], self.bar_mm, self.radius_mm + by[3], turned)

        def heights(by: FloatArray) -> FloatArray:
            return np.array([changed(by).height_mm(below) for below in contacts])

        return changed(least_squares(heights, np.zeros(6), x_scale=[1, 1, 1, 1, 0.3, 0.3]).x)

    def glidecal(self, contacts: FloatArray) -> Delta:
        """From a ``printer.cfg`` through `import` and `export`."""
        with tempfile.TemporaryDirectory() as name:
            config, session, out = (Path(name) / f for f in ("printer.cfg", "s.jsonl", "out.cfg"))
            config.write_text(self.config(contacts), "utf-8")
            for words in (
                ("import", config, "-o", session),
                ("export", session, "--format", "klipper", "-o", out),
            ):
                status, _, message = run_here(*map(str, words))
                if status:
                    raise ValueError(message)
            return delta(keys(out.read_text("utf-8"))[""])

    def config(self, contacts: FloatArray) -> str:
        """As Klipper has it, a step of 1 µm."""
        lines = [f"[printer]\nkinematics: delta\ndelta_radius: {self.radius_mm}\n[delta_calibrate]"]
        for number, below in enumerate(contacts):
            steps = ",".join(f"{1000.0 * mm:.3f}" for mm in below)
            lines += [f"height{number}: 0.0", f"height{number}_pos: {steps}"]
        towers = zip("abc", self.stop_mm, self.bar_mm, self.angle_deg, strict=True)
        lines += [
            f"[stepper_{tower}]\nfull_steps_per_rotation: 200\nmicrosteps: 16\n"
            f"rotation_distance: 3.2\nposition_endstop: {stop:.6f}\narm_length: {bar:.6f}\n"
            f"angle: {angle:.6f}"
            for tower, stop, bar, angle in towers
        ]
        return "\n".join(lines) + "\n"

    def missed_mm(self, fit: str, contacts: FloatArray) -> FloatArray:
        """Of each contact ``(n,)``, by a fit of the others."""
        missed = []
        for number, contact in enumerate(contacts):
            others = np.delete(contacts, number, axis=0)
            fitted: Delta = getattr(self, fit)(others)
            zero = np.mean([fitted.height_mm(below) for below in others])
            missed.append(fitted.height_mm(contact) - zero)
        return np.array(missed)


Keys = dict[tuple[str, str], str]


def keys(text: str) -> dict[str, Keys]:
    """Numbers of a file by section and key: those in force, behind # and in the saved block."""
    kinds: dict[str, Keys] = {"": {}, "#": {}, "#*#": {}}
    section = ""
    for line in text.splitlines():
        header = re.match(r"(?:#\*#)?\s*\[(.+?)\]", line)
        section = header[1] if header else section
        if match := LINE.match(line):
            kinds[match[1] or ""].setdefault((section, match[2]), match[3])
    return kinds


def of_towers(values: Keys, key: str, usual: tuple[float, ...] | None = None) -> FloatArray:
    """A key of every tower ``(3,)``; Klipper takes that of the first where one has none."""
    own = [values.get((f"stepper_{tower}", key)) for tower in "abc"]
    spare = usual or (float(values["stepper_a", key]),) * 3
    return np.array([float(a) if a else b for a, b in zip(own, spare, strict=True)])


def delta(values: Keys) -> Delta:
    """Of these numbers; raises KeyError where a delta has not all of them."""
    return Delta(
        of_towers(values, "position_endstop"),
        of_towers(values, "arm_length"),
        float(values["printer", "delta_radius"]),
        of_towers(values, "angle", USUAL_DEG),
    )


def read(text: str) -> tuple[Delta, FloatArray]:
    """Where the owner began, and contacts ``(n, 3)``, mm below the switches."""
    kinds = keys(text)
    saved, values = kinds["#*#"], kinds["#*#"] | kinds["#"] | kinds[""]
    turn = of_towers(values, "full_steps_per_rotation", (200.0,) * 3)
    step_mm = of_towers(values, "rotation_distance") / turn / of_towers(values, "microsteps")
    steps = [v.split(",") for (_, k), v in saved.items() if re.fullmatch(r"height\d+_pos", k)]
    below = np.array(steps, dtype=float) * step_mm
    started = delta(values)
    started = replace(started, stop_mm=np.full(3, started.stop_mm.mean()))
    zero = float(np.mean([started.height_mm(contact) for contact in below]))
    return replace(started, stop_mm=started.stop_mm - zero), below


def main() -> None:
    fits, totals, known = ("before", "six", "glidecal"), [], set()
    print(f"| file | {' | '.join(fits)} |")
    for path in sorted(Path(sys.argv[1]).rglob("*.cfg")):
        try:
            started, contacts = read(path.read_text("utf-8", "replace"))
            if contacts.tobytes() in known:
                continue
            known.add(contacts.tobytes())
            totals.append([rms(started.missed_mm(fit, contacts)) for fit in fits])
        except (KeyError, ValueError) as problem:
            print(f"{path.name}: not used, {problem}", file=sys.stderr)
            continue
        print(f"| {path.stem} | {' | '.join(f'{mm:.3f}' for mm in totals[-1])} |", flush=True)
    for word, row in (("r.m.s.", rms), ("median", np.median)):
        cells = " | ".join(f"{row(column):.3f}" for column in np.array(totals).T)
        print(f"| {word} of {len(totals)} | {cells} |")


if __name__ == "__main__":
    main()
