"""What the tool keeps with any values entered: a correction, a view of the papers, nothing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from calib.arrays import LEG_NAMES, FloatArray
from calib.errors import ImpossibleRequest
from calib.posterior.cells import BASE
from calib.posterior.correction import projector_of
from calib.posterior.models import Posterior, effects_of_tool
from calib.posterior.tool import Frame, ToolField, mean_square, tool_field
from calib.stats import mixture_uncertainties
from calib.tripod.effects.drives import ActuatorScale, AxisOffset
from calib.tripod.effects.effect import PER_THOUSAND, EffectInstance
from calib.tripod.pipeline import MOVES_THE_TOOL, Model

if TYPE_CHECKING:  # scipy.optimize comes with it
    from calib.tripod.towers import EnteredTowers

OFFSETS = (0, 1, 2)
"""Columns of the joint offsets in the tool's field."""


def nothing_entered(posterior: Posterior) -> FloatArray:
    """Values ``(6 + k,)`` of a controller that stays as it is."""
    return np.zeros(posterior.field.rows.shape[1])


def values_of(field: ToolField, model: Model) -> FloatArray:
    """Parameters and effects of a model in the field ``(6 + k,)``; those of readings are not there.

    Raises ImpossibleRequest for an effect of the tool that the field does not know.
    """
    values = np.zeros(field.rows.shape[1])
    values[:BASE] = model.parameters_mm
    for effect in model.effects:
        if isinstance(effect, EffectInstance) and (effect.effect, effect.place) in field.columns:
            columns = field.columns[effect.effect, effect.place]
            values[columns] += np.real(effect.values)
        elif effect.stage in MOVES_THE_TOOL:
            raise ImpossibleRequest(
                f"effect {effect.id}", "no law of this posterior", "effects of its sessions' model"
            )
    return values


def offsets_beside(model: Model, machine: Model, frame: Frame) -> tuple[FloatArray, float]:
    """Joint offsets ``(3,)`` that leave a machine least where the controller holds ``model``, too.

    With what they leave at the tool, r.m.s. over the workspace in the frame, mm. What is kept is a
    part of the machine.
    """
    laws = dict.fromkeys((acting.effect, acting.place) for acting in effects_of_tool(machine))
    field = tool_field(machine.geometry, tuple(laws))
    off, entered = values_of(field, machine) - values_of(field, model), np.zeros(len(field.rows[0]))
    entered[list(OFFSETS)] = projector_of(field, OFFSETS, frame) @ off
    return entered[list(OFFSETS)], math.sqrt(mean_square(field.metrics[frame], off - entered))


def tower_values(posterior: Posterior, entered: EnteredTowers) -> FloatArray:
    """Switches, bars, towers and travels of a printer's firmware in the field ``(6 + k,)``.

    Raises ImpossibleRequest for travels where the field has no scale of the drives.
    """
    field, values = posterior.field, nothing_entered(posterior)
    values[:3] = entered.change_mm
    values[3:BASE] = entered.towers.length_mm - entered.now.length_mm
    moved = entered.towers.feet_mm - entered.now.feet_mm
    law = AxisOffset(tuple(posterior.geometry.across))
    for place, across in posterior.geometry.across.items():
        (column,) = field.columns[law, place]
        values[column] = moved[LEG_NAMES.index(place[0])] @ across[:2]
    scales = [
        EffectInstance(ActuatorScale(), name, (part / PER_THOUSAND,))
        for name, part in zip(LEG_NAMES, entered.stretch.tolist(), strict=True)
        if part
    ]
    return values + values_of(field, Model(posterior.geometry).with_effects(tuple(scales)))


def offset_uncertainties_mm(
    posterior: Posterior, frame: Frame, *, less_common: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Standard deviations and 95 % half widths ``(3,)`` of joint offsets entered alone, mm.

    Over all models, about the values that are entered; with ``less_common`` less what all three
    share.
    """
    into = projector_of(posterior.field, OFFSETS, frame)
    if less_common:
        into = into - into.mean(axis=0)
    middle = into @ posterior.likeliest_labels.mean
    means, variances = [], []
    of_bases: dict[int, FloatArray] = {}
    for model in posterior.models_in_field:
        if id(model.base) not in of_bases:
            of_bases[id(model.base)] = ((into @ model.base) * into).sum(axis=1)
        of_base, of_root = of_bases[id(model.base)], ((into @ model.root) ** 2).sum(axis=1)
        means.append(into @ model.mean - middle)
        variances.append(model.inflated**2 * of_base + of_root)
    weight = np.array([model.weight for model in posterior.models])
    return mixture_uncertainties(weight, np.array(means), np.array(variances))
