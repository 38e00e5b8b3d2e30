"""What a correction leaves at the tool of the hidden machine, however it was worked out.

``python -m tests.blind.corrections --count 25 --seed 6 --jsonl FILE`` gives sessions of the bench's
own machines to a program and measures every answer. A session goes out as a table of readings and
the resolution of its indicators; an answer comes back as the joint coordinates that the controller
would send, with the bounds that were promised. Beside it: nothing entered, and who knows which law
is hidden and fits its size to the same readings.
"""

from __future__ import annotations

import argparse
import importlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from tests.blind.cases import BLUNDERS, PROCEDURES, SHAPES, USUAL_NOISES, Case
from tests.blind.claims import TILTED, TOLERANCE_MM, Claim, claim
from tests.blind.corrections_page import (
    BEFORE,
    IDEAL,
    IDEAL_BOUND,
    INTRODUCTION,
    LAW,
    OFFSETS,
    beside,
    page,
)
from tests.blind.effects import EFFECT_IDS, Direction, visible
from tests.blind.forward import FloatArray, Hidden, carriages, readings
from tests.blind.ideal import Judge, mean_of
from tests.blind.noise import RESOLUTION_MM
from tests.blind.signatures import BASE, Columns
from tests.blind.tool import (
    Commanded,
    entered,
    errors_mm,
    reachable_mm,
    reached_mm,
    rms_mm,
    without_rigid_motion,
)

Json = dict[str, Any]

NEAR_ZERO_MM = 50.0
"""Half the side of the workpiece about Zero whose errors relative to Zero are measured."""

SPREAD = {"offset": 2.0, "length": TOLERANCE_MM, "lean": 2e-3, "shift": 0.5}
"""Standard deviations, mm and rad, that who knows the law expects; other sizes are free.

Without them a shift of two axes could not be told from an offset of the third.
"""
FIT_ROUNDS = 6
DRAWN = 200
"""Machines whose 95 % quantile is the bound of the ideal judge; the seed of the draws, too."""
INVERSION_ROUNDS = 12


@dataclass(frozen=True)
class Errors:
    """R.m.s. of the tool's error over the reachable workspace, carriages coming up and down, mm.

    ``machine`` as it is; ``touched_off`` less the best shift; ``aligned`` less the best shift and
    turn; ``near`` within `NEAR_ZERO_MM` of Zero, relative to Zero reached coming up.
    """

    machine: float
    touched_off: float
    aligned: float
    near: float


@dataclass(frozen=True)
class Answer:
    """A correction by its name, and the 95 % bounds promised for it: mm by the names of `Errors`.

    ``remark`` is kept with the results.
    """

    name: str
    commanded: Commanded
    bounds: dict[str, float] = field(default_factory=dict)
    remark: str = ""


Answerer = Callable[[str, float | None], Sequence[Answer]]
"""From a table of readings and the resolution of the indicators, mm or None. The answer named
`OFFSETS` is what the others are compared with."""


def judge(hidden: Hidden, commanded: Commanded) -> Errors:
    """What the tool of the hidden machine is off by if the controller sends these joints."""
    off, places = errors_mm(hidden, commanded), reachable_mm()
    zero = reached_mm(hidden, commanded(np.zeros((1, 3)), 1.0), 1.0)
    about = np.tile((np.abs(places) <= NEAR_ZERO_MM).all(axis=1), 2)
    return Errors(
        machine=rms_mm(off),
        touched_off=rms_mm(off - off.mean(axis=0)),
        aligned=rms_mm(without_rigid_motion(off)),
        near=rms_mm(off[about] - zero),
    )


def nothing() -> Commanded:
    """The controller as it is."""
    return entered(np.zeros(3), np.zeros(3))


def inverse_of(machine: Hidden) -> Commanded:
    """The joints with which the tool of this machine is where it was sent."""

    def commanded(tool_mm: FloatArray, way: float) -> FloatArray:
        joints = carriages(tool_mm)
        for _ in range(INVERSION_ROUNDS):  # Newton with the derivatives of the nominal machine
            joints = joints + carriages(tool_mm) - carriages(reached_mm(machine, joints, way))
        return joints

    return commanded


def knows_the_law(session: Claim) -> Commanded:
    """The correction of who knows which effects are hidden, and where, and fits their sizes."""
    return inverse_of(fitted(session))


def displayed_mm(session: Claim) -> FloatArray:
    """Readings ``(n,)`` without gross mistakes, as the table gives them."""
    step_mm = RESOLUTION_MM if session.resolution_mm else 1e-6
    return np.asarray(np.round(session.values_mm / step_mm) * step_mm)


def knows_the_catalogue(
    session: Claim, entered_offsets: Commanded | None
) -> tuple[Commanded, dict[str, float]]:
    """The correction of the ideal `Judge`, who does not know which effects are hidden.

    Beside it how far off the tool of 95 of 100 machines that it draws is, mm by the names of
    `Errors`, where the offsets of the program are entered; empty without these.
    """
    spread = np.array([SPREAD[name] for name, _ in BASE])
    ideal = Judge(session, displayed_mm(session), spread)
    models = ideal.weighted(len(session.effects), EFFECT_STRENGTHS)
    commanded = mean_of(
        [(share, inverse_of(ideal.machine(model, fit.values))) for share, model, fit in models]
    )
    if entered_offsets is None:
        return commanded, {}
    rng = np.random.default_rng(DRAWN)
    errors = [asdict(judge(m, entered_offsets)) for m in ideal.drawn(models, DRAWN, rng)]
    names = errors[0]
    return commanded, {n: float(np.quantile([e[n] for e in errors], 0.95)) for n in names}


def fitted(session: Claim) -> Hidden:
    """The machine by least squares: offsets, lengths, zeros and sizes of the hidden effects.

    Linear about the fit of the round before. Gross mistakes of the table are known and undone.
    """
    values = displayed_mm(session)
    directions: list[Direction] = [((entry, 1.0),) for entry in BASE]
    directions += [
        visible(direction) for effect in session.effects for direction in effect.directions
    ]
    spread = np.array([SPREAD.get(direction[0][0][0], np.inf) for direction in directions])
    settings = (session.hidden.lead_mm, session.hidden.saw_period_mm, session.hidden.waves)
    plain, sizes = Hidden(Hidden().amounts, *settings), np.zeros(len(directions))
    machine = plain
    for number in range(FIT_ROUNDS):
        columns = Columns(session.rows, machine)
        moved = [columns.direction(direction, machine.lead_mm) for direction in directions]
        design = np.column_stack([*moved, columns.base[:, len(BASE) :]]) / session.noise_mm
        if number == 0:  # some effects show only once offsets do
            design[:, len(BASE) : len(sizes)] = 0.0
        expected = np.eye(len(sizes), design.shape[1]) / spread[:, None]
        residual = np.concatenate(
            [(values - readings(session.rows, machine)) / session.noise_mm, -sizes / spread]
        )
        rows = np.vstack([design, expected])
        length = np.linalg.norm(rows, axis=0)
        scale = np.where(length > 0.0, length, 1.0)
        step = np.linalg.lstsq(rows / scale, residual, rcond=1e-12)[0] / scale
        sizes = sizes + step[: len(sizes)]
        machine = plain.plus(
            [
                (e, w * v)
                for direction, v in zip(directions, sizes.tolist(), strict=True)
                for e, w in direction
            ]
        )
    return machine


EFFECT_STRENGTHS = (0.5, 1.0, 2.0)
LENGTH_SPREADS_MM = (0.03, 0.1)
OUTSIDE = (*SHAPES, "straightness_cubic")
HIDDEN: dict[str, Sequence[tuple[str, ...]]] = {
    "nothing": ((),),
    "one effect": [(effect,) for effect in EFFECT_IDS],
    "two effects": list(combinations(EFFECT_IDS, 2)),
    "outside": [(shape,) for shape in OUTSIDE],
    TILTED: ((),),
    "gross mistakes beside": [(effect,) for effect in EFFECT_IDS],
}
CELLS = tuple(HIDDEN)


def cases(
    cell: str, count: int, seed: int, strengths: Sequence[float] = EFFECT_STRENGTHS
) -> Iterator[tuple[Case, float]]:
    """So many cases of a cell, each with the spread of the bars; every effect in turn."""
    rng = np.random.default_rng([seed, crc32(cell.encode())])
    effects: list[tuple[str, ...]] = []
    for n in range(count):
        if not effects:
            effects = [HIDDEN[cell][k] for k in rng.permutation(len(HIDDEN[cell]))]
        names = effects.pop()
        sizes = tuple(float(rng.choice(strengths)) for _ in names)
        shape = names[0] if names and names[0] in SHAPES else ""
        blunder = BLUNDERS[n % len(BLUNDERS)] if cell == "gross mistakes beside" else ""
        yield (
            Case(
                f"correction/{cell}/{n}",
                cell,
                PROCEDURES[n % len(PROCEDURES)],
                str(rng.choice(USUAL_NOISES)),
                () if shape else names,
                sizes,
                blunder,
                shape,
            ),
            float(rng.choice(LENGTH_SPREADS_MM)),
        )


def sessions(
    count: int,
    seed: int,
    cells: Sequence[str] = CELLS,
    strengths: Sequence[float] = EFFECT_STRENGTHS,
) -> Iterator[tuple[Case, Claim]]:
    """So many sessions of each cell, the same for the same seed; strengths as in `claim`.

    Strength 1 is what readings just show; a fault that a workshop would notice has 10 and more.
    """
    for cell in cells:
        for case, spread_mm in cases(cell, count, seed, strengths):
            yield case, claim(case, seed, spread_mm)


def measured(case: Case, session: Claim, answerer: Answerer, *, ideal: bool = False) -> Json:
    """One line of results: every answer at the hidden machine, of which it knows the table alone.

    ``ideal`` adds that of `knows_the_catalogue` where nothing but its effects is hidden.

    An answerer that fails, even by a defect, is a line without answers and does not end the run.
    """
    start, failure = time.process_time(), ""
    try:
        answers = answerer(session.table, session.resolution_mm)
    except Exception as problem:
        answers, failure = (), f"{type(problem).__name__}: {problem}"[:300]
    used_s = time.process_time() - start
    plain = {BEFORE: nothing(), LAW: knows_the_law(session)}
    commands = {answer.name: answer.commanded for answer in answers}
    bounds = {answer.name: answer.bounds for answer in answers}
    if ideal and not case.shape and case.cell != TILTED:
        plain[IDEAL], bound = knows_the_catalogue(session, commands.get(OFFSETS))
        if bound:
            commands[IDEAL_BOUND], bounds[IDEAL_BOUND] = commands[OFFSETS], bound
    return {
        **asdict(case),
        "errors": {
            name: asdict(judge(session.hidden, command))
            for name, command in (plain | commands).items()
        },
        "bounds": bounds,
        "remarks": {answer.name: answer.remark for answer in answers},
        "failure": failure,
        "cpu_s": round(used_s, 3),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.corrections``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.corrections", description=__doc__)
    parser.add_argument("--seed", type=int, default=6)
    parser.add_argument("--count", type=int, default=4, help="sessions of each cell")
    parser.add_argument("--cells", nargs="+", choices=CELLS, default=CELLS)
    parser.add_argument("--strengths", nargs="+", type=float, default=EFFECT_STRENGTHS)
    parser.add_argument(
        "--answerer", default="tests.blind.today:answers", help="MODULE:FUNCTION that answers"
    )
    parser.add_argument(
        "--ideal", action="store_true", help="the ideal judge, too: 15 s more for two effects"
    )
    parser.add_argument("--jsonl", type=Path, help="a line for each session")
    parser.add_argument(
        "--beside", type=Path, help="lines of another answerer, whose answers stand beside as was:…"
    )
    parser.add_argument("-o", "--output", type=Path, help="the page, in place of the terminal")
    options = parser.parse_args(arguments)
    module, _, name = options.answerer.partition(":")
    answerer: Answerer = getattr(importlib.import_module(module), name)
    lines = []
    for case, session in sessions(options.count, options.seed, options.cells, options.strengths):
        lines.append(measured(case, session, answerer, ideal=options.ideal))
        if options.jsonl:
            with options.jsonl.open("a", encoding="utf-8") as target:
                target.write(json.dumps(lines[-1]) + "\n")
    if options.beside:
        text = options.beside.read_text(encoding="utf-8")
        lines = beside(lines, [json.loads(line) for line in text.splitlines()])
    text = page(lines)
    if options.output:
        options.output.write_text(f"{INTRODUCTION}\n{text}\n", encoding="utf-8")
    else:
        print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
