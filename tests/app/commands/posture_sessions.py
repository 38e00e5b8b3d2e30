"""Sessions of postures for tests: simulated, and the tables that a person would fill in."""

from __future__ import annotations

import csv
from pathlib import Path

from app.measuring.hexaslide import PosturePlan, PostureTaking, measure_simulated
from protocols.hexaslide import load_hexaslide
from protocols.hexaslide_session import load_posture_procedure, read_postures

Rows = list[list[str]]
IMPORT = ("import", "--machine", "hexaslide", "--protocol")


def quiet(_words: str) -> None:
    """Nothing is said."""


def plan(path: Path, procedure: str, seed: int | None = None) -> PosturePlan:
    posture_procedure = load_posture_procedure(procedure)
    return PosturePlan(path, load_hexaslide(), "hexaslide-h60.toml", posture_procedure, seed=seed)


def simulated(path: Path, procedure: str, seed: int) -> Path:
    taking = PostureTaking.begin(plan(path, procedure, seed))
    measure_simulated(taking, seed, quiet)
    return path


def table(path: Path, session: Path) -> Rows:
    """What a person would have filled in, with units; written to ``path``."""
    record, _ = read_postures(session)
    names = record.opened.procedure.whole().measured
    units = ["deg" if name in ("theta", "psi", "phi") else "mm" for name in names]
    rows = [["posture", *(f"slider{k}" for k in range(1, 7)), *names], ["", *["mm"] * 6, *units]]
    rows += [
        [str(reading.posture), *map(repr, reading.sliders_mm), *map(repr, reading.values)]
        for reading in record.readings
    ]
    write(path, rows)
    return rows


def write(path: Path, rows: Rows) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)
