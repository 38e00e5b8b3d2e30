"""Which way the tool is off over the workspace, as expected by a posterior."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.arrays import FloatArray
from calib.posterior.correction import MAP_POINTS, ToolOff
from calib.posterior.tool import Frame
from calib.tripod.workspace import PLANES, PlaneMap, plane_map


@dataclass(frozen=True, eq=False)
class VectorMap:
    """Expected errors of the tool on a plane through Zero, mm.

    ``along_across`` and ``along_up`` are their parts in the plane, ``length`` that of the whole,
    each ``(n, n)``, rows upwards, NaN where the tool does not reach.
    """

    along_across: PlaneMap
    along_up: PlaneMap
    length: FloatArray


def vector_maps(off: ToolOff, frame: Frame) -> tuple[VectorMap, ...]:
    """The errors on the three planes, the mean of both ways there; less what the frame takes up."""
    field = off.posterior.field
    wrong = off.posterior.likeliest_labels.mean - off.values

    def along(k: int, tool_mm: FloatArray) -> FloatArray:
        return np.asarray(field.rows_at(tool_mm, frame).mean(axis=0)[:, k] @ wrong)

    maps = []
    for across, up in PLANES:
        plane = field.geometry, (across, up), MAP_POINTS
        parts = [plane_map(*plane, partial(along, k)) for k in range(3)]
        length = np.sqrt(sum(part.value**2 for part in parts))
        maps.append(VectorMap(parts[across], parts[up], np.asarray(length)))
    return tuple(maps)
