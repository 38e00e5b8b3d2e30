"""Postures of a Hexa Slide from a file: a table, or what ``glidecal postures --json`` wrote."""

from __future__ import annotations

import csv
import json
from io import StringIO
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from calib.errors import RecordError
from protocols.documents import Document, describe, read_text

MOST_POSTURES = 10_000

Metres = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]


class Posture(Document):
    """One posture."""

    x_m: Metres
    y_m: Metres
    z_m: Metres
    theta_deg: Degrees
    psi_deg: Degrees
    phi_deg: Degrees


class _Written(BaseModel):
    """The part of a ``glidecal.postures/1`` document that counts here."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False)

    postures: Annotated[tuple[Posture, ...], Field(min_length=1, max_length=MOST_POSTURES)]


COLUMNS = tuple(Posture.model_fields)


def load_postures(path: Path) -> NDArray[np.float64]:
    """Postures ``(p, 6)`` in metres and radians, from ``.csv`` with a header line or ``.json``.

    Raises RecordError naming the line.
    """
    text = read_text(path, "posture file")
    found = _from_json(path, text) if path.suffix == ".json" else _from_table(path, text)
    rows = np.array([[getattr(one, name) for name in COLUMNS] for one in found])
    rows[:, 3:] = np.radians(rows[:, 3:])
    return rows


def _from_json(path: Path, text: str) -> tuple[Posture, ...]:
    try:
        return _Written.model_validate_json(text).postures
    except ValidationError as problem:
        raise _refused(path, describe(problem)) from problem


def _from_table(path: Path, text: str) -> tuple[Posture, ...]:
    reader = csv.DictReader(StringIO(text))
    if set(reader.fieldnames or ()) != set(COLUMNS):
        raise _refused(path, f"line 1: columns {', '.join(reader.fieldnames or ()) or 'none'}")
    found = []
    for row in reader:
        try:
            numbers = {name: float(value) for name, value in row.items()}
            # JSON, so that NaN and infinity are refused in one place
            found.append(Posture.model_validate_json(json.dumps(numbers)))
        except (TypeError, ValueError) as problem:
            reason = describe(problem) if isinstance(problem, ValidationError) else "no six numbers"
            raise _refused(path, f"line {reader.line_num}: {reason}") from problem
    if not 1 <= len(found) <= MOST_POSTURES:
        raise _refused(path, f"{len(found)} postures")
    return tuple(found)


def _refused(path: Path, found: str) -> RecordError:
    return RecordError(
        f"posture file {path}",
        found,
        f"1 to {MOST_POSTURES} postures with the columns {', '.join(COLUMNS)}",
    )
