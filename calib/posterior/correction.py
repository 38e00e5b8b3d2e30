"""What to enter: the expected error of the tool, projected onto what a controller can hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from calib.arrays import FloatArray
from calib.posterior.cells import BASE
from calib.posterior.library import POWERS
from calib.posterior.models import Posterior
from calib.posterior.tool import FRAMES, Frame, ToolField, mean_square
from calib.posterior.tool_errors import ToolErrors
from calib.tripod.effects.bars import GravitySag
from calib.tripod.effects.drives import (
    ActuatorCyclic,
    ActuatorScale,
    AxisLean,
    AxisOffset,
    Backlash,
    Straightness,
)
from calib.tripod.effects.effect import Effect, EffectInstance
from calib.tripod.effects.empirical import Empirical, Repeating
from calib.tripod.pipeline import Model
from calib.tripod.workspace import PLANES, PlaneMap, plane_map

Holds = Literal["offsets", "play", "tables", "kinematics"]
HOLDS: tuple[Holds, ...] = ("offsets", "play", "tables", "kinematics")

TIED = 1e-4
"""Of the mean square in the machine's own frame: what a frame leaves free is entered as small as
that makes it, and no combination that does nothing is entered at all."""

WORTH = 0.01
"""Of the expected mean square of the tool's error: what gains less is not worth an entry."""

WORTH_A_TABLE = 0.1
"""The same of tables, a twentieth of the r.m.s. error: 65 rows a joint for 0.0066 instead of 0.0068
mm are a burden."""

DOUBTED = 0.05
"""Weight from which a model has a say on each part."""

EVEN = 0.5
"""Probability of a larger error from which on a gain that few models expect is no reason: it made
the tool worse in 8 of 216 blind sessions."""

MAP_POINTS = 5
"""Along each side of a map of the tool's error."""

LARGE = 0.4
"""Of the expected mean square: what gains more is entered though it is likelier to harm. Two names
that explain the readings alike, of 0.6 and 0.4, are both put right in part."""


@dataclass(frozen=True)
class LeftOut:
    """A part that is not entered, and why."""

    part: str
    reason: str


@dataclass(frozen=True, eq=False)
class ToolOff:
    """R.m.s. error of the tool over the workspace with values of the field ``(6 + k,)`` entered.

    In each frame, mm. Beside it, in every frame, ``beside_mm`` of how the controller holds them.
    """

    posterior: Posterior
    values: FloatArray = field(repr=False)
    beside_mm: float = 0.0
    _bounds_mm: dict[Frame, float] = field(default_factory=dict)
    _least_mm: dict[Frame, float] = field(default_factory=dict)

    def bound_in(self, frame: Frame) -> float:
        """Bound in this frame, mm, which 95 % of the posterior keep; worked out once."""
        if frame not in self._bounds_mm:
            errors = self.posterior.for_bounds.tool_errors[frame]
            self._bounds_mm[frame] = math.hypot(errors.bound_mm(self.values), self.beside_mm)
        return self._bounds_mm[frame]

    @property
    def bound_mm(self) -> dict[Frame, float]:
        """The 95 % bound in every frame."""
        return {frame: self.bound_in(frame) for frame in FRAMES}

    def least_in(self, frame: Frame) -> float:
        """What is expected less all that 95 % of the posterior differ from it; at least 0, mm."""
        if frame not in self._least_mm:
            expected = self.posterior.mean
            metric = self.posterior.field.metrics[frame]
            shown_mm = math.sqrt(mean_square(metric, expected - self.values))
            guard_mm = self.posterior.for_bounds.tool_errors[frame].bound_mm(expected)
            self._least_mm[frame] = max(0.0, shown_mm - guard_mm)
        return self._least_mm[frame]

    @property
    def least_mm(self) -> dict[Frame, float]:
        """The expected error in every frame."""
        return {frame: self.least_in(frame) for frame in FRAMES}

    def maps(self, frame: Frame) -> tuple[PlaneMap, ...]:
        """What is expected on the three planes through Zero, r.m.s. of both ways there."""
        field, errors = self.posterior.field, self.posterior.tool_errors[frame]
        moment = errors.moment(self.values)

        def expected_mm(tool_mm: FloatArray) -> FloatArray:
            rows = field.rows_at(tool_mm, frame)
            square = np.einsum("wpif,wpif->p", rows @ moment, rows) / len(rows)
            return np.asarray(np.sqrt(square + errors.unplaced_mm2))

        geometry = field.geometry
        return tuple(plane_map(geometry, plane, MAP_POINTS, expected_mm) for plane in PLANES)


@dataclass(frozen=True, eq=False)
class Correction:
    """What a controller holds, the best in a frame: the tool with it, and the ``model`` it is told.

    ``left_out`` are parts that are not entered.
    """

    frame: Frame
    holds: Holds
    off: ToolOff
    model: Model
    left_out: tuple[LeftOut, ...]


Part = tuple[str, tuple[int, ...]]
"""What a controller holds as one entry, by its name, and its columns in the tool's field."""


def parts_of(posterior: Posterior, holds: Holds) -> dict[Holds, list[Part]]:
    """What a controller holds, the simplest first; each in the parts that it is entered in."""
    parts: dict[tuple[Holds, str], list[int]] = {("offsets", "offsets"): [0, 1, 2]}
    parts["kinematics", "lengths"] = [3, 4, 5]
    for law in posterior.field.columns:
        if entry := _part_of(*law):
            parts.setdefault(entry, []).extend(posterior.field.columns[law])
    return {
        group: [(name, tuple(index)) for (holder, name), index in parts.items() if holder == group]
        for group in HOLDS[: HOLDS.index(holds) + 1]
    }


def _part_of(effect: Effect, place: str) -> tuple[Holds, str] | None:
    """Which part of a controller holds a law at a place."""
    if isinstance(effect, Backlash):
        return "play", f"play of {place}"
    powers = isinstance(effect, Empirical) and len(effect.bases) == 1 and effect.bases[0] in POWERS
    if powers or isinstance(effect, ActuatorScale | ActuatorCyclic | Repeating):
        return "tables", f"table of {place}"
    if isinstance(effect, AxisLean) or type(effect) is AxisOffset:
        return "kinematics", f"axis {place[0]}"
    if type(effect) is Straightness:
        return "kinematics", f"guide {place[0]}"
    return ("kinematics", "weight on the bars") if isinstance(effect, GravitySag) else None


def correction(
    posterior: Posterior,
    holds: Holds,
    frame: Frame = "touched-off",
    absent: Mapping[str, str] | None = None,
    *,
    tabled: bool = True,
) -> Correction:
    """The best values to enter; travels of drives in tables of many rows where it is ``tabled``.

    ``absent`` are parts that this controller does not take, with the reason: by their name
    (``play of x``), or all that begin with a word (``play``). The values are expected with the
    likeliest labels; what the tool keeps with them is judged with all.
    """
    absent, likeliest = absent or {}, posterior.likeliest_labels
    errors = likeliest.tool_errors[frame]
    corrected: list[Part] = []
    values = np.zeros(len(posterior.mean))
    left_out: list[LeftOut] = []
    for group, parts in parts_of(posterior, holds).items():
        fitting = []
        for part in parts:
            reason = absent.get(part[0]) or absent.get(part[0].split()[0], "")
            left_out += [LeftOut(part[0], reason)] if reason else []
            fitting += [] if reason else [part]
        projected = _projected(likeliest, [*corrected, *fitting], frame)
        worth = WORTH_A_TABLE if tabled and group == "tables" else WORTH
        if corrected and fitting and (reason := doubt(errors, projected, values, worth)):
            left_out.append(LeftOut(group, reason))
            continue
        corrected, values = [*corrected, *fitting], projected
    return Correction(
        frame,
        holds,
        ToolOff(posterior, values),
        model_of(posterior, values),
        tuple(left_out),
    )


def projector_of(field: ToolField, index: Sequence[int], frame: Frame) -> FloatArray:
    """Values of these columns ``(n,)`` as a map ``(n, f)`` of what is expected in the field.

    Waves of a drive are entered as they are expected: nothing else is of their kind, and between
    the places of the workspace a wave that follows something else does harm.
    """
    waves = {
        k
        for law in field.columns
        if isinstance(law[0], ActuatorCyclic | Repeating)
        for k in field.columns[law]
    }
    inner = field.metrics[frame] + TIED * field.metrics["machine"]
    mapped = np.eye(len(inner))[list(index)]
    fitted = [row for row, k in enumerate(index) if k not in waves]
    columns = [index[row] for row in fitted]
    scale = 1.0 / np.sqrt(np.maximum(inner[columns, columns], 1e-30))
    block = inner[np.ix_(columns, columns)] * scale[:, None] * scale
    target = scale[:, None] * inner[columns]
    target[:, [k for k in index if k in waves]] = 0.0
    mapped[fitted] = scale[:, None] * np.linalg.solve(block + 1e-9 * np.eye(len(columns)), target)
    return mapped


def _projected(posterior: Posterior, parts: Sequence[Part], frame: Frame) -> FloatArray:
    """Least squares of the expected error over the workspace ``(f,)``."""
    index = [k for _, columns in parts for k in columns]
    values = np.zeros(len(posterior.mean))
    values[index] = projector_of(posterior.field, index, frame) @ posterior.mean
    return values


def doubt(
    errors: ToolErrors, with_it: FloatArray, without: FloatArray, worth: float = WORTH
) -> str:
    """Why more is not worth entering, empty where it is: it gains less than `worth`, or harms.

    What no reading of a leg shows of the frame is no reason against what they do show.
    """
    weight = errors.weight
    loss_mm2 = errors.expected(without) - errors.expected(with_it)
    gain = float(weight @ loss_mm2)
    without_mm2 = errors.seen.expected_mm(without) ** 2
    worst = float(np.max(-loss_mm2[weight >= DOUBTED], initial=0.0))
    if gain <= worth * without_mm2:
        return f"it lowers the expected square of the tool's error by less than {worth:.0%}"
    if worst > gain:
        return "it would raise the error under a model that the readings leave open"
    if float(weight[loss_mm2 < 0.0].sum()) > EVEN and gain < LARGE * without_mm2:
        return "it is likelier to raise the tool's error than to lower it"
    return ""


def model_of(posterior: Posterior, values: FloatArray) -> Model:
    """The machine with these values: what a controller is told."""
    field = posterior.field
    effects = []
    for law in field.columns:
        sizes = values[field.columns[law]]
        if sizes.any():
            effects.append(EffectInstance(*law, tuple(float(v) for v in sizes)))
    return Model(posterior.geometry, tuple(float(v) for v in values[:BASE]), tuple(effects))
