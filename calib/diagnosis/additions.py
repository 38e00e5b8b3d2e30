"""Measurements that may be added: where, at which displacements, and what is changed before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from calib.observations import LEG_NAMES, Conditions, conditions
from calib.orthoglide.model import Model

CYCLES = 3
SECONDS_PER_STEP = 20.0


@dataclass(frozen=True)
class Preparation:
    """What is changed before measuring: offsets entered in the controller, mm, and the load."""

    entered_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    load: float = 1.0

    @property
    def words(self) -> str:
        """An instruction, empty where nothing is changed."""
        said = [
            f"add {change:+g} mm to the entered joint offset of {leg.upper()}"
            for leg, change in zip(LEG_NAMES, self.entered_mm, strict=True)
            if change
        ]
        if self.load != 1.0:
            said.append(
                f"load the tool to {self.load:g} times its weight and note load = {self.load:g} "
                "in the machine file"
            )
        return " and ".join(said)

    def model(self, model: Model) -> Model:
        """The machine as it is then."""
        parameters = np.array(model.parameters_mm)
        parameters[:3] -= self.entered_mm
        return replace(
            model.with_parameters(parameters), geometry=replace(model.geometry, load=self.load)
        )


@dataclass(frozen=True)
class Added:
    """An added measurement: legs, stations, displacements from Zero, what is changed before."""

    legs: tuple[str, ...]
    stations: tuple[float, ...]
    levels_mm: tuple[float, ...]
    preparation: Preparation = Preparation()

    @property
    def words(self) -> str:
        """In short."""
        levels = ", ".join(f"{level:+g}" if level else "Zero" for level in self.levels_mm)
        legs = "leg " if len(self.legs) == 1 else "legs "
        places = " and ".join(f"{station:.0%}" for station in self.stations)
        before = f"{self.preparation.words}; then " if self.preparation.words else ""
        return (
            f"{before}{legs}{', '.join(self.legs).upper()}, {places} from the tool end: "
            f"Zero, {levels} mm"
        )

    @property
    def steps(self) -> int:
        """How many postures are visited."""
        return len(self.legs) * len(self.stations) * (CYCLES * (len(self.levels_mm) + 1) + 1)


def added_conditions(levels: Sequence[tuple[float, tuple[float, ...]]]) -> Conditions:
    """Readings on all legs for each station and its displacements, each with mountings of its own.

    Zero before every cycle and last, both axes.
    """
    return _joined([_at_station(*each) for each in levels])


def _at_station(station: float, levels: Sequence[float]) -> Conditions:
    cycle = [0.0, *levels]
    path = cycle * CYCLES + [0.0]
    rows = [
        (leg, axis, k)
        for leg in range(3)
        for axis in range(3)
        if axis != leg
        for k in range(len(path))
    ]
    step = np.array([k for _, _, k in rows])
    made = conditions(
        [leg for leg, _, _ in rows],
        [axis for _, axis, _ in rows],
        [path[k] for k in step],
        station=station,
    )
    return replace(
        made,
        approach=np.concatenate([[0.0], np.sign(np.diff(path))])[step],
        time_s=SECONDS_PER_STEP * step,
        cycle=step // len(cycle) + 1,
    )


def _joined(parts: Sequence[Conditions]) -> Conditions:
    """One after the other; mountings stay apart."""
    arrays = {
        f.name: np.concatenate([getattr(one, f.name) for one in parts]) for f in fields(Conditions)
    }
    before = np.cumsum([0, *(one.mount_count for one in parts)])
    arrays["mount"] = np.concatenate(
        [one.mount + start for one, start in zip(parts, before, strict=False)]
    )
    return Conditions(**arrays)
