"""What to enter: the expected error of the tool, projected onto what a controller can hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import gammainc

from calib.arrays import FloatArray
from calib.posterior.cells import BASE
from calib.posterior.library import ELSE, POWERS
from calib.posterior.posterior import Posterior, _held
from calib.posterior.readings import Placed
from calib.posterior.tool import FRAMES, Frame
from calib.stats import COVERAGE
from calib.tripod.effects.bars import GravitySag
from calib.tripod.effects.drives import ActuatorCyclic, ActuatorScale, Backlash, Straightness
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.effects.empirical import Empirical
from calib.tripod.pipeline import Model

Holds = Literal["offsets", "play", "tables", "kinematics"]
HOLDS: tuple[Holds, ...] = ("offsets", "play", "tables", "kinematics")

TIED = 1e-4
"""Of the mean square in the machine's own frame: what a frame leaves free is entered as small as
that makes it, and no combination that does nothing is entered at all."""

DOUBTED = 0.05
"""Weight from which a model has a say on each part."""


@dataclass(frozen=True)
class LeftOut:
    """A part that is not entered, and why."""

    part: str
    reason: str


@dataclass(frozen=True, eq=False)
class Correction:
    """Values in the tool's field ``(6 + k,)`` that a controller holds, and what the tool keeps.

    ``bound_mm`` is the r.m.s. error over the workspace that 95 % of the posterior keeps, in each
    frame; ``expected_mm`` its root of the expected mean square.
    """

    frame: Frame
    holds: Holds
    values: FloatArray
    model: Model
    bound_mm: dict[Frame, float]
    expected_mm: float
    left_out: tuple[LeftOut, ...]


def parts_of(posterior: Posterior, holds: Holds) -> list[tuple[str, list[int]]]:
    """Parts that a controller can hold and their columns in the field; offsets are one part."""
    field = posterior.field
    offsets = [("offsets", [0, 1, 2])]
    by_place: dict[str, list[int]] = {}

    def add(part: str, one: Placed) -> None:
        by_place.setdefault(part, []).extend(field.columns_of(one))

    shift, lean = _held(posterior.geometry)
    for one in field.placed:
        effect, place = one
        if isinstance(effect, Backlash):
            if holds != "offsets":
                add(f"play of {place}", one)
        elif isinstance(effect, ActuatorScale | ActuatorCyclic) or (
            isinstance(effect, Empirical) and len(effect.bases) == 1 and effect.bases[0] in POWERS
        ):
            if holds in ("tables", "kinematics"):
                add(f"table of {place}", one)
        elif holds == "kinematics":
            if effect in (shift, lean):
                add(f"axis {place[0]}", one)
            elif type(effect) is Straightness:
                add(f"guide {place[0]}", one)
            elif isinstance(effect, GravitySag):
                add("weight on the bars", one)
    if holds == "kinematics":
        by_place["lengths"] = [3, 4, 5]
    return [*offsets, *by_place.items()]


def correction(posterior: Posterior, holds: Holds, frame: Frame = "touched-off") -> Correction:
    """The best values to enter."""
    parts = parts_of(posterior, holds)
    left_out: list[LeftOut] = []
    values = _projected(posterior, [k for _, index in parts for k in index], frame)
    for name, index in list(parts[1:]):
        without = [k for part, some in parts if part != name for k in some]
        reason = _doubt(posterior, frame, values, _projected(posterior, without, frame))
        if reason:
            parts.remove((name, index))
            left_out.append(LeftOut(name, reason))
            values = _projected(posterior, without, frame)
    distances = {one: distances_of(posterior, one, values) for one in FRAMES}
    return Correction(
        frame,
        holds,
        values,
        model_of(posterior, values),
        {one: quantile_mm(distances[one]) for one in FRAMES},
        math.sqrt(sum(w * m for w, m, _ in distances[frame])),
        tuple(left_out),
    )


def _projected(posterior: Posterior, index: Sequence[int], frame: Frame) -> FloatArray:
    """Least squares of the expected error over the workspace ``(6 + k,)``."""
    field = posterior.field
    metric, whole = field.metrics[frame], field.metrics["machine"]
    chosen = list(index)
    inner = metric + TIED * whole
    scale = 1.0 / np.sqrt(np.maximum(inner[chosen, chosen], 1e-30))
    block = inner[np.ix_(chosen, chosen)] * scale[:, None] * scale
    target = scale * (inner[chosen] @ posterior.mean)
    values = np.zeros(len(posterior.mean))
    values[chosen] = scale * np.linalg.solve(block + 1e-9 * np.eye(len(chosen)), target)
    return values


def _doubt(posterior: Posterior, frame: Frame, with_it: FloatArray, without: FloatArray) -> str:
    """Why a part is not worth entering; empty where it is."""
    metric = posterior.field.metrics[frame]
    gain, worst = 0.0, 0.0
    for model in posterior.models:
        mean, _ = posterior.in_field(model)
        before, after = mean - without, mean - with_it
        more = float(before @ metric @ before - after @ metric @ after)
        gain += model.weight * more
        if model.weight >= DOUBTED:
            worst = max(worst, -more)
    if gain <= 0.0:
        return "it does not lower the expected error of the tool"
    if worst > gain:
        return "it would raise the error under a model that the readings leave open"
    return ""


Distance = tuple[float, float, float]
"""Weight, mean and variance of the mean square of the tool's error, mm² and mm⁴."""


def distances_of(posterior: Posterior, frame: Frame, values: FloatArray) -> list[Distance]:
    """Of every model with these values entered; something else acts as each law without a name."""
    metric = posterior.field.metrics[frame]
    found: list[Distance] = []
    for model in posterior.models:
        mean, into = posterior.in_field(model)
        off = mean - values
        inner = into.T @ metric @ into
        moved = inner @ model.covariance
        slope = into.T @ (metric @ off)
        size = float(np.trace(moved) + off @ metric @ off)
        variance = 2.0 * float(np.trace(moved @ moved)) + 4.0 * float(
            slope @ model.covariance @ slope
        )
        unseen = posterior.unseen(model)
        hidden = np.outer(unseen, unseen) * posterior.field.rigid_metrics[frame]
        size += float(np.trace(hidden))
        variance += 2.0 * float(np.trace(hidden @ hidden))
        if not any(posterior.components[k].id == ELSE for k in model.members):
            found.append((model.weight, size, variance))
            continue
        squares = posterior.something_else(model, metric)
        found += [
            (model.weight / len(squares), size + square, variance + 2.0 * square**2)
            for square in squares.tolist()
        ]
    return found


def quantile_mm(distances: Sequence[Distance]) -> float:
    """Root of the 95 % quantile of a mixture of gamma distributions of these moments."""
    weight, size, variance = np.array(distances).T
    variance = np.maximum(variance, 1e-12 * size**2)
    shape, scale = size**2 / variance, variance / np.maximum(size, 1e-300)
    low, high = 0.0, float((size + 20.0 * np.sqrt(variance)).max())
    for _ in range(60):
        middle = (low + high) / 2.0
        below = float((weight * gammainc(shape, middle / scale)).sum() / weight.sum())
        low, high = (middle, high) if below < COVERAGE else (low, middle)
    return math.sqrt(high)


def model_of(posterior: Posterior, values: FloatArray) -> Model:
    """The machine with these values: what a controller is told."""
    field = posterior.field
    effects = []
    for one in field.placed:
        mine = values[list(field.columns_of(one))]
        if mine.any():
            effects.append(EffectInstance(*one, tuple(float(v) for v in mine)))
    return Model(posterior.geometry, tuple(float(v) for v in values[:BASE]), tuple(effects))
