"""Sessions of postures for tests: simulated, and the tables that a person would fill in."""

from __future__ import annotations

import csv
from pathlib import Path

from app.measuring.hexaslide import PostureTaking, measure_simulated
from app.version import program
from protocols.hexaslide import load_hexaslide
from protocols.hexaslide_session import PosturesOpened, load_posture_procedure, read_postures

Rows = list[list[str]]
IMPORT = ("import", "--machine", "hexaslide", "--protocol")


def quiet(_words: str) -> None:
    """Nothing is said."""


def opened(procedure: str, seed: int | None = None) -> PosturesOpened:
    return PosturesOpened(
        program=program(),
        origin="measured" if seed is None else "simulated",
        machine=load_hexaslide(),
        machine_file="hexaslide-h60.toml",
        procedure=load_posture_procedure(procedure),
        seed=seed,
    )


def simulated(path: Path, procedure: str, seed: int) -> Path:
    taking = PostureTaking.begin(path, opened(procedure, seed))
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
