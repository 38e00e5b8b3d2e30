"""What may be missing in a Hexa Slide's model: every cause at every place, as columns.

What a cause does to a carriage moves the platform by the inverse of the kinematics, and what is
read with it. Mistakes of the readings are causes, too, that move nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.arrays import FloatArray
from calib.hexaslide.arms import Turn, transposed
from calib.hexaslide.geometry import CHAINS, Geometry, HexaSlide, legs
from calib.hexaslide.procedures import COMPONENTS
from calib.hexaslide.residuals import Readings, postures_of, read_at

MISTAKE, FRAME = "wrong_posture", "other_frame"
OF_READINGS = MISTAKE, FRAME
"""Causes that are of the readings, not of the machine."""

UNIT_SCALE = 1e-4
UNIT_GROWTH = 5e-5
UNIT_LENGTH_M = 2e-5
UNIT_WAVE_M = 1e-5
UNIT_FRAME_M = 1e-3
UNIT_OF_NOISE = 10.0
"""Unremarkable sizes: of a rail's scale and of growth (in 1), of play, offsets and crookedness, of
a wave, of another frame (as of a start: beside smaller ones no change of a leg would show, which
moves the platform much as a frame does), and of a wrong reading in standard deviations."""

BOW_M = 0.5
"""A rail that is bowed is off by its size so far from the middle of its travel."""

STEP = 1e-6
"""Metres and radians, for slopes of what is read by the posture: central differences."""


@dataclass(frozen=True, eq=False)
class HexaSlideCause:
    """What may be missing: its effect on what is read, ``columns`` ``(n, r)`` per unremarkable
    size, on places ``(3 p, r)`` and on carriages ``(p, 6, r)``; ``names`` of its values, their
    ``unit`` and its ``size``. ``share`` is its part of the prior of its name at its place: a
    mistake may be of one value or of all.
    """

    id: str
    where: str
    names: tuple[str, ...]
    unit: str
    size: float
    columns: FloatArray
    places: FloatArray
    carriages: FloatArray
    share: float = 1.0


@dataclass(frozen=True)
class AdoptedEffect:
    """A cause that a model has at a place, its ``values`` ``(r,)`` in its unit; no fit changes them
    where they are ``held``. ``deviations`` ``(r,)`` are their standard uncertainties.
    """

    id: str
    where: str
    values: tuple[float, ...]
    held: bool = False
    deviations: tuple[float, ...] = ()


def mistake_at(readings: Readings, row: int) -> tuple[str, str]:
    """Id and place of the cause that a posture is wrong."""
    return MISTAKE, f"posture {readings.number(row)}"


def mistakes_of(
    readings: Readings, machine: HexaSlide, postures: FloatArray
) -> Iterator[HexaSlideCause]:
    """Places may be measured in another frame, and every posture may be wrong: all of its values,
    as of a target that slipped, or as likely one of them, as of a cell mistyped.
    """
    effects = _Effects(readings, machine, postures)
    if {*COMPONENTS[:3]} <= {*readings.procedure.read}:
        yield effects.of_frame(postures)
    values = range(len(readings.procedure.read))
    wrong = [(tuple(values), 1.0)]
    if len(values) > 1:
        # as all values, each by at least 10 deviations, one that is off by 6 is hardly likely
        wrong = [(tuple(values), 0.5), *(((k,), 0.5 / len(values)) for k in values)]
    for row in range(len(readings.sliders)):
        for columns, share in wrong:
            yield effects.of_posture(row, columns, share, *mistake_at(readings, row))


def causes_of_machine(
    readings: Readings,
    machine: HexaSlide,
    postures: FloatArray,
    lead_m: float | None,
    middle: FloatArray,
    ways: FloatArray | None = None,
) -> Iterator[HexaSlideCause]:
    """Every cause that moves the platform, at every place.

    Scale and bow do nothing where sliders are in the ``middle`` ``(6,)``. Of play carriages stay
    behind on the ``ways`` ``(p, 1)`` by which they came, up 1 and down -1; None: as from posture to
    posture, up to the first.
    """
    effects = _Effects(readings, machine, postures)
    sliders, at = readings.sliders, legs(machine.geometry, postures)
    unit = at.arms.unit
    telescopic = machine.geometry.telescopic
    part = machine.geometry.part
    from_middle = sliders - middle
    if ways is None:
        ways = np.sign(np.diff(sliders, axis=0, prepend=sliders[:1] - 1.0))
    for k in range(CHAINS):
        of_rail, where = np.eye(CHAINS)[k], f"{part} {k + 1}"
        scale, play = [from_middle * of_rail], [-0.5 * ways * of_rail]
        yield effects.of_sliders(f"{part}_scale", where, ("scale",), "mm/m", UNIT_SCALE, scale)
        id_of_play = "leg_backlash" if telescopic else "backlash"
        yield effects.of_sliders(id_of_play, where, ("play",), "mm", UNIT_LENGTH_M, play)
        if not telescopic:  # what only a rail and the joint on its carriage can have
            across = [np.linalg.norm(unit - machine.geometry.rails, axis=-1) * of_rail]
            yield effects.of_sliders(
                "joint_offset", where, ("offset",), "mm", UNIT_LENGTH_M, across
            )
            bow, sides = (from_middle / BOW_M) ** 2, _sides(machine.geometry, k)
            bows = [bow * (unit[:, k] @ side)[:, None] * of_rail for side in sides]
            names = ("side 1", "side 2")
            yield effects.of_sliders("straightness", where, names, "mm", UNIT_LENGTH_M, bows)
        if lead_m is not None:
            angle = 2.0 * np.pi * sliders / lead_m
            waves = [np.sin(angle) * of_rail, np.cos(angle) * of_rail]
            names = ("sine", "cosine")
            yield effects.of_sliders(f"{part}_wave", where, names, "mm", UNIT_WAVE_M, waves)
    time = np.linspace(0.0, 1.0, len(sliders))[:, None]
    growth = [time * (at.lean if telescopic else sliders)]
    where = f"all {part}s"
    yield effects.of_sliders("thermal_growth", where, ("growth",), "mm/m", UNIT_GROWTH, growth)


class _Effects:
    """What carriages and readings that are off do to what is read, in its noise."""

    def __init__(self, readings: Readings, machine: HexaSlide, postures: FloatArray) -> None:
        self._noise, self._names = readings.value_noise, readings.procedure.read
        self._count = len(postures)
        self._moved = np.linalg.inv(legs(machine.geometry, postures).arms.by_posture)

        def read(step: FloatArray) -> FloatArray:
            return read_at(readings.procedure, machine, postures + step)

        steps = STEP * np.eye(len(COMPONENTS))
        slopes = [(read(step) - read(-step)) / (2.0 * STEP) for step in steps]
        self._by_posture = np.stack(slopes, axis=-1)

    def of_sliders(
        self,
        cause: str,
        where: str,
        names: tuple[str, ...],
        unit: str,
        size: float,
        sliders: list[FloatArray],
    ) -> HexaSlideCause:
        """Carriages off by ``sliders`` ``(p, 6)`` per 1, 1000 units; ``size`` is unremarkable."""
        carriages = size * np.stack(sliders, axis=-1)
        moved = self._moved @ carriages
        columns = self._by_posture @ moved / self._noise[:, None]
        flat, places = (part.reshape(-1, len(names)) for part in (columns, moved[:, :3]))
        return HexaSlideCause(cause, where, names, unit, size * 1e3, flat, places, carriages)

    def of_frame(self, postures: FloatArray) -> HexaSlideCause:
        """What was measured lies in another frame than the machine. Parameters take over a turn
        about X.
        """
        turns = np.eye(3)[1:]
        moved = np.zeros((self._count, len(COMPONENTS), 5))
        moved[:, :3, :3] = np.eye(3)
        moved[:, :3, 3:] = np.cross(turns, postures[:, None, :3]).swapaxes(1, 2)
        moved[:, 3:, 3:] = np.linalg.solve(transposed(Turn.at(postures[:, 3:]).axes), turns.T)
        columns = self._by_posture @ moved / self._noise[:, None] * UNIT_FRAME_M
        shifts = tuple(f"{name} off" for name in COMPONENTS[:3])
        names = (*shifts, "Y turned, in 1 m", "Z turned, in 1 m")
        size = 1e3 * UNIT_FRAME_M
        return self._still(FRAME, "all postures", names, "mm", size, columns, 1.0)

    def of_posture(
        self, row: int, wrong: tuple[int, ...], share: float, cause: str, where: str
    ) -> HexaSlideCause:
        """These values of a posture wrong."""
        columns = np.zeros((self._count, len(self._noise), len(wrong)))
        columns[row, wrong, range(len(wrong))] = UNIT_OF_NOISE
        names = tuple(f"{self._names[k]} off" for k in wrong)
        return self._still(cause, where, names, "noise", UNIT_OF_NOISE, columns, share)

    def _still(
        self,
        cause: str,
        where: str,
        names: tuple[str, ...],
        unit: str,
        size: float,
        columns: FloatArray,
        share: float,
    ) -> HexaSlideCause:
        """A cause that moves nothing, with its effect on what is read ``(p, m, r)``."""
        count = len(names)
        still = np.zeros((3 * self._count, count)), np.zeros((self._count, CHAINS, count))
        flat = columns.reshape(-1, count)
        return HexaSlideCause(cause, where, names, unit, size, flat, *still, share)


def _sides(geometry: Geometry, chain: int) -> tuple[FloatArray, FloatArray]:
    """Two directions across a rail, the first level."""
    rail = np.asarray(geometry.rails[chain])
    level = np.cross(rail, [0.0, 0.0, 1.0])
    length = np.linalg.norm(level)
    first = level / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
    return first, np.cross(rail, first)


def with_effects(
    readings: Readings,
    machine: HexaSlide,
    lead_m: float | None,
    effects: Sequence[AdoptedEffect],
    middle: FloatArray | None = None,
) -> Readings:
    """Readings with carriages where they are on a ``machine`` that has these effects; ``middle`` as
    `weighed` takes it.

    Raises as `postures_of`.
    """
    if not effects:
        return readings
    postures = postures_of(readings, machine)
    middle = readings.sliders.mean(axis=0) if middle is None else middle
    causes = causes_of_machine(readings, machine, postures, lead_m, middle)
    by_name = {(cause.id, cause.where): cause for cause in causes}
    sliders = readings.sliders.copy()
    for effect in effects:
        cause = by_name[effect.id, effect.where]
        sliders += cause.carriages @ np.divide(effect.values, cause.size)
    return replace(readings, sliders=sliders)
