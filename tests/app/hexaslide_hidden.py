"""Sessions of postures of a machine that hides a cause, measured by the simulation of the bench."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np

from calib.hexaslide.residuals import Readings
from protocols.hexaslide import HexaSlideMachine, load_hexaslide
from protocols.hexaslide_session import (
    POSTURE_FORM,
    PostureProcedure,
    PostureReading,
    PosturesOpened,
    SixMm,
)
from protocols.journal import write_whole
from protocols.session import Line
from tests.blind.hexaslide import LEAD_M, Hidden, Plain, measured


def machine_file() -> HexaSlideMachine:
    """H60 with the lead that waves of the bench have."""
    return load_hexaslide().model_copy(update={"lead_mm": 1000.0 * LEAD_M})


def hidden_session(
    path: Path,
    cause: Hidden,
    machine: int = 22,
    take: int = 0,
    kind: str = "position",
    count: int | None = None,
) -> Path:
    """The ``machine`` of this number with a hidden cause, measured once more for each ``take``.

    Only the first ``count`` postures, None: those of the bench.
    """
    file = machine_file()
    true = Plain(file, np.random.default_rng(machine))
    readings = measured(true, file, kind, cause, np.random.default_rng([machine, take]))
    return written(path, file, readings, count)


def written(
    path: Path, file: HexaSlideMachine, readings: Readings, count: int | None = None
) -> Path:
    """A record of these readings, of the first ``count`` postures."""
    kind = readings.procedure.kind.value
    opened = PosturesOpened(
        program="tests",
        origin="imported",
        machine=file,
        machine_file="machine.toml",
        procedure=PostureProcedure(
            name=kind,
            kind=readings.procedure.kind,
            noise_mm=1000.0 * readings.length_noise_m,
            noise_deg=float(np.degrees(readings.angle_noise_rad)),
        ),
    )
    values = readings.measured.copy()
    values[:, :3] *= 1000.0
    values[:, 3:] = np.degrees(values[:, 3:])
    lines: list[Line] = [
        PostureReading(
            reading=number,
            posture=number,
            sliders_mm=cast("SixMm", tuple((1000.0 * sliders).tolist())),
            values=tuple(row.tolist()),
            text="",
        )
        for number, (sliders, row) in enumerate(zip(readings.sliders, values, strict=True), start=1)
    ]
    write_whole(path, opened, lines[:count], POSTURE_FORM)
    return path
