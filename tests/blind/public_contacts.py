"""Ten measured heights of a real printer, each left out once: how well the others predict it.

The heights and the geometry of the EEPROM are in ``shared/data/deltas`` beside the repository, or
in the folder that GLIDECAL_DELTAS names. glidecal goes from a table of contacts to the exported
file; the peer is Klipper's fit of six factors (switches, a radius, two angles). Both are run by the
formulas of the firmware: what they miss is the height of the tool over the plate in the contact
that is left out, less the mean of the others.

    python -m tests.blind.public_contacts
"""

from __future__ import annotations

import csv
import os
import tempfile
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from protocols.machine import machine_text
from protocols.printers.tower_printer import Contact, TowerPrinter
from tests.app.cli import run_here
from tests.app.exports.upright_towers import TURN_MM, klipper
from tests.blind.printers import Firmware, FloatArray, firmware, fitted
from tests.conftest import ROOT

HEIGHTS = Path(os.environ.get("GLIDECAL_DELTAS") or ROOT.parent / "shared" / "data" / "deltas")
LOOSE_MM = 4.0
"""Ten times what `import` expects of where a tower stands: this printer's are off by so much."""

Fit = Callable[[Sequence[FloatArray]], Firmware]


@dataclass(frozen=True, eq=False)
class Printer:
    """What the firmware of this printer holds, and where its tool met the plate."""

    stops_mm: tuple[float, float, float]
    radius_mm: float
    angles_deg: FloatArray
    bar_mm: float
    contacts: tuple[FloatArray, ...]

    @classmethod
    def read(cls, folder: Path) -> Printer:
        """A height is how far the probe went down: the tool was so much lower in the contact."""
        stated = tomllib.loads((folder / "ten_heights_machine.toml").read_text("utf-8"))
        towers = np.array(
            [np.subtract(d["origin_mm"], d["platform_mm"])[:2] for d in stated["drive"]]
        )
        with (folder / "ten_heights.csv").open(encoding="utf-8") as file:
            rows = np.array(
                [
                    [float(row["x_mm"]), float(row["y_mm"]), -float(row["value_mm"])]
                    for row in csv.DictReader(file)
                ]
            )
        rows[:, 2] -= rows[:, 2].mean()
        x, y, z = stated["position_endstop_mm"]
        return cls(
            (x, y, z),
            float(np.hypot(*towers.T).mean()),
            np.degrees(np.arctan2(towers[:, 1], towers[:, 0])) % 360.0,
            stated["leg_length_mm"],
            tuple(rows),
        )

    @property
    def believed(self) -> Firmware:
        """As the contacts were measured."""
        stops = np.array(self.stops_mm)
        return firmware(stops, self.radius_mm, self.angles_deg, self.bar_mm)

    def uncalibrated(self, _contacts: Sequence[FloatArray]) -> Firmware:
        """Whatever the contacts are."""
        return self.believed

    def six(self, contacts: Sequence[FloatArray]) -> Firmware:
        """Klipper's six factors."""
        return fitted(
            [*contacts],
            6,
            self.stops_mm,
            radius_mm=self.radius_mm,
            angles_deg=self.angles_deg,
            bar_mm=self.bar_mm,
        )

    def ours(self, contacts: Sequence[FloatArray], across_mm: float | None = None) -> Firmware:
        """From the table of contacts to what `export` writes.

        ``across_mm`` is the tolerance of where a tower stands; None: that of `import`.
        """
        a, b, c = self.angles_deg.tolist()
        printer = TowerPrinter(
            "printer",
            "printer",
            (self.bar_mm,) * 3,
            (self.radius_mm,) * 3,
            self.stops_mm,
            (a, b, c),
            rotation_distance_mm=(TURN_MM,) * 3,
        )
        places = [Contact((x, y, z), "") for x, y, z in (p.tolist() for p in self.contacts)]
        stated = printer.machine(places)
        if across_mm is not None:
            stated = stated.model_copy(update={"across_tolerance_mm": across_mm})
        rows = [f"{x:.4f},{y:.4f},{z:.5f},0" for x, y, z in contacts]
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            table, machine, session, out = (
                folder / file for file in ("t.csv", "m.toml", "s.jsonl", "out.cfg")
            )
            table.write_text("\n".join(["x_mm,y_mm,z_mm,height_mm", *rows]) + "\n", "utf-8")
            machine.write_text(machine_text(stated, []), "utf-8")
            for words in (
                ("import", table, "-o", session, "--machine", machine),
                ("export", session, "--format", "klipper", "-o", out),
            ):
                status, _, message = run_here(*map(str, words))
                assert status == 0, message
            return klipper(out.read_text("utf-8"))

    def height_mm(self, run: Firmware, contact: FloatArray) -> float:
        """Of the tool over the plate in a contact, if firmware ``run`` holds the true machine."""
        below = self.believed(contact)

        def off(place: FloatArray) -> FloatArray:
            return run(place) - below

        return float(least_squares(off, contact).x[2])

    def missed_mm(self, fit: Fit) -> FloatArray:
        """Of each contact ``(n,)``, by a fit of the others."""
        errors = []
        for number, contact in enumerate(self.contacts):
            others = [*self.contacts[:number], *self.contacts[number + 1 :]]
            run = fit(others)
            zero = np.mean([self.height_mm(run, place) for place in others])
            errors.append(self.height_mm(run, contact) - zero)
        return np.array(errors)


def rms(values: FloatArray) -> float:
    return float(np.sqrt((values**2).mean()))


def main() -> None:
    printer = Printer.read(HEIGHTS)
    fits: dict[str, Fit] = {
        "before": printer.uncalibrated,
        "six factors": printer.six,
        "glidecal": printer.ours,
        f"glidecal, across_tolerance_mm = {LOOSE_MM:g}": partial(printer.ours, across_mm=LOOSE_MM),
    }
    print("| | left out, mm | all ten, mm |")
    for name, fit in fits.items():
        run = fit(printer.contacts)
        heights = np.array([printer.height_mm(run, place) for place in printer.contacts])
        print(f"| {name} | {rms(printer.missed_mm(fit)):.3f} | {heights.std():.3f} |", flush=True)


if __name__ == "__main__":
    main()
