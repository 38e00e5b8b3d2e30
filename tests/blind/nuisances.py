"""Set-ups as they are in a workshop: exchanged labels, first takes apart, noise with a memory.

``python -m tests.blind.nuisances --count 10`` makes sessions of the bench's own machines, hands
their tables to the posterior and counts what it answers; with ``-o docs/nuisances.md`` as a page.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tests.blind.blunders import Table
from tests.blind.cases import PROCEDURES
from tests.blind.effects import LETTERS
from tests.blind.forward import FloatArray, Hidden, IntArray, Rows, readings
from tests.blind.generator import scatter_mm, table_text
from tests.blind.signatures import BASE
from tests.blind.steps import PLANS, rows_of

if TYPE_CHECKING:
    from calib.posterior.models import Posterior

PLAY_MM = 0.05
DRIFT_MM = 0.03
SERIAL = 0.8
COARSE_MM = 0.01
LISTED = 0.05
"""Probability from which on a name is listed."""
SHOWN = 3.0
"""Standard deviations by which a first take within play differs from both ends of it, or it cannot
be told from one that was reached from a side."""
TIMED = ("thermal_drift", "thermal_growth", "stand_drift")


@dataclass(frozen=True, eq=False)
class Session:
    """One table and the machine behind it; ``place`` is what was done to it, and where.

    A mistake is named rightly if its name begins with that. ``shown`` is whether readings can tell.
    """

    table: str
    resolution_mm: float | None
    hidden: Hidden
    place: str = ""
    shown: bool = True


def machine(rng: np.random.Generator) -> Hidden:
    """Joint offsets and lengths, nothing else."""
    amounts = [*rng.uniform(-2.0, 2.0, 3), *(rng.choice([0.03, 0.1]) * rng.standard_normal(3))]
    return Hidden().plus([(e, float(v)) for e, v in zip(BASE, amounts, strict=True)])


def taken(
    procedure: str, hidden: Hidden, rng: np.random.Generator, noise_mm: FloatArray | None = None
) -> tuple[Rows, FloatArray]:
    """Rows and readings of a session, each mounting with a zero of its own."""
    rows = rows_of(PLANS[procedure], rng)
    zeros = rng.uniform(-0.5, 0.5, rows.mount.max() + 1)
    noise = scatter_mm(rng) * rng.standard_normal(len(rows)) if noise_mm is None else noise_mm
    return rows, readings(rows, hidden) + zeros[rows.mount] + noise


def first_rows(rows: Rows, leg: int | None = None) -> IntArray:
    """Rows of the first visit of each mounting, of one leg or of all."""
    first = np.unique(rows.mount, return_index=True)[1]
    return np.asarray(first if leg is None else first[rows.leg[first] == leg])


def plain(rows: Rows, values: FloatArray, hidden: Hidden, place: str = "") -> Session:
    """The session as written down."""
    return Session(table_text(Table(rows, values), None), None, hidden, place)


def nothing(procedure: str, rng: np.random.Generator) -> Session:
    hidden = machine(rng)
    return plain(*taken(procedure, hidden, rng), hidden)


def heavy_tails(procedure: str, rng: np.random.Generator) -> Session:
    hidden, count = machine(rng), len(rows_of(PLANS[procedure], rng))
    noise = scatter_mm(rng) * rng.standard_t(3, count) / np.sqrt(3.0)
    return plain(*taken(procedure, hidden, rng, noise), hidden)


def coarse_display(procedure: str, rng: np.random.Generator) -> Session:
    """Steps of 10 µm, which nobody states."""
    hidden = machine(rng)
    rows, values = taken(procedure, hidden, rng)
    return plain(rows, np.round(values / COARSE_MM) * COARSE_MM, hidden)


def _serial(rows: Rows, sigma_mm: float, rng: np.random.Generator) -> FloatArray:
    noise = np.zeros(len(rows))
    for mount in range(rows.mount.max() + 1):
        error = float(rng.standard_normal())
        for k in np.flatnonzero(rows.mount == mount):
            noise[k] = error
            error = SERIAL * error + float(np.sqrt(1.0 - SERIAL**2) * rng.standard_normal())
    return sigma_mm * noise


def serial_noise(procedure: str, rng: np.random.Generator) -> Session:
    hidden = machine(rng)
    rows, values = taken(procedure, hidden, rng, np.zeros(1))
    return plain(rows, values + _serial(rows, scatter_mm(rng), rng), hidden)


def true_drift(procedure: str, rng: np.random.Generator) -> Session:
    """One axis drifts by `DRIFT_MM` within a mounting, whatever the noise."""
    rows = rows_of(PLANS[procedure], rng)
    axis, hours = int(rng.integers(3)), float(np.ptp(rows.time_s[rows.mount == 0]))
    hidden = machine(rng).plus([(("drift", (axis,)), DRIFT_MM / hours)])
    return plain(*taken(procedure, hidden, rng), hidden)


def legs_exchanged(procedure: str, rng: np.random.Generator) -> Session:
    """The tables of two legs stand under each other's names, column by column."""
    hidden = machine(rng)
    rows, values = taken(procedure, hidden, rng)
    a, b = rng.choice(3, 2, replace=False).tolist()
    crossed = bool(rng.integers(2))
    values_changed = values.copy()
    for station in np.unique(rows.station):
        tables: dict[tuple[int, int], Any] = {}
        for leg, second in ((a, b), (b, a)):
            c = 3 - leg - second
            axes = (second, c)
            tables |= {
                (leg, k): np.flatnonzero(
                    (rows.leg == leg) & (rows.axis == axis) & (rows.station == station)
                )
                for k, axis in enumerate(axes)
            }
        for k in range(2):
            here, there = tables[a, k], tables[b, 1 - k if crossed else k]
            values_changed[here], values_changed[there] = values[there], values[here]
    return plain(
        rows, values_changed, hidden, f"legs_exchanged:{LETTERS[min(a, b)]},{LETTERS[max(a, b)]}"
    )


def postures_exchanged(procedure: str, rng: np.random.Generator) -> Session:
    """Two postures of one set-up, in one cycle or in all."""
    hidden = machine(rng)
    rows, values = taken(procedure, hidden, rng)
    leg, cycle = int(rng.integers(3)), int(rng.integers(1, rows.cycle.max() + 1))
    a, b = rng.choice(np.unique(rows.displacement_mm), 2, replace=False).tolist()
    here = (rows.leg == leg) & (rows.station == rng.choice(np.unique(rows.station)))
    if rng.integers(2):
        here &= rows.cycle == cycle
    values_changed = values.copy()
    for axis in range(3):
        for number in range(1, int(rows.cycle.max()) + 1):
            gauge_rows = here & (rows.axis == axis) & (rows.cycle == number)
            first, two = (np.flatnonzero(gauge_rows & (rows.displacement_mm == d)) for d in (a, b))
            count = min(len(first), len(two))
            values_changed[first[:count]], values_changed[two[:count]] = (
                values[two[:count]],
                values[first[:count]],
            )
    return plain(rows, values_changed, hidden, f"postures_exchanged:{LETTERS[leg]}")


def within_play(procedure: str, rng: np.random.Generator) -> Session:
    """A carriage has play; every first take stands somewhere within it."""
    leg = int(rng.integers(3))
    hidden = machine(rng).plus([(("lost", (leg,)), PLAY_MM)])
    rows, values = taken(procedure, hidden, rng)
    down = replace(rows, moved=-np.ones_like(rows.moved))
    up = replace(rows, moved=np.ones_like(rows.moved))
    as_driven = readings(rows, hidden)
    noise = values - as_driven
    noise -= (np.bincount(rows.mount, noise) / np.bincount(rows.mount))[rows.mount]
    sigma_mm = float(np.sqrt((noise**2).sum() / (len(rows) - rows.mount.max() - 1)))
    visible = False
    for first in first_rows(rows):
        share = float(rng.uniform())
        ends = np.array([readings(down, hidden)[first], readings(up, hidden)[first]])
        between = float(np.array([share, 1.0 - share]) @ ends)
        alike = (rows.mount == rows.mount[first]) & (
            rows.displacement_mm == rows.displacement_mm[first]
        )
        # against the mean of its repeats, which are those of one side
        least_mm = SHOWN * sigma_mm * np.sqrt(1.0 + 1.0 / (alike.sum() - 1.0))
        visible |= bool(np.abs(ends - between).min() > least_mm)
        values[first] += between - as_driven[first]
    return replace(plain(rows, values, hidden, "first_take"), shown=visible)


def with_play(rng: np.random.Generator) -> Hidden:
    """A machine with play of one carriage."""
    return machine(rng).plus([(("lost", (int(rng.integers(3)),)), PLAY_MM)])


def settled(
    size_mm: float, machine: Callable[[np.random.Generator], Hidden] = machine
) -> Callable[[str, np.random.Generator], Session]:
    def made(procedure: str, rng: np.random.Generator) -> Session:
        """The stand settles after the first take of one leg."""
        hidden, leg = machine(rng), int(rng.integers(3))
        rows, values = taken(procedure, hidden, rng)
        values[first_rows(rows, leg)] += size_mm * rng.choice([-1.0, 1.0], 1)
        return plain(rows, values, hidden, f"first_take:{LETTERS[leg]}")

    return made


def wrong_first_posture(
    procedure: str,
    rng: np.random.Generator,
    machine: Callable[[np.random.Generator], Hidden] = machine,
) -> Session:
    """The first Zero of one leg was taken at Max."""
    hidden, leg = machine(rng), int(rng.integers(3))
    rows, values = taken(procedure, hidden, rng)
    first = first_rows(rows, leg)
    there = rows.displacement_mm.copy()
    there[first] = 60.0
    at_max = readings(replace(rows, displacement_mm=there), hidden)
    values[first] += at_max[first] - readings(rows, hidden)[first]
    return plain(rows, values, hidden, f"first_take:{LETTERS[leg]}")


KINDS: dict[str, Callable[[str, np.random.Generator], Session]] = {
    "nothing": nothing,
    "t3 noise": heavy_tails,
    "10 µm display": coarse_display,
    "serial noise 0.8": serial_noise,
    "true drift": true_drift,
    "legs exchanged": legs_exchanged,
    "postures exchanged": postures_exchanged,
    "first take within play": within_play,
    "settled 20 µm": settled(0.02),
    "settled 60 µm": settled(0.06),
    "settled 100 µm": settled(0.1),
    "settled 60 µm, play": settled(0.06, with_play),
    "first Zero at Max": wrong_first_posture,
    "first Zero at Max, play": partial(wrong_first_posture, machine=with_play),
}


def posterior_of(table: str, resolution_mm: float | None) -> Posterior:
    """What a user's import and the posterior make of a table."""
    from app.commands.sessions import import_files
    from app.evaluating.correction import case_of
    from app.evaluating.loading import load_sessions
    from calib.posterior.posterior import posterior
    from calib.tripod.pipeline import Model

    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stderr(io.StringIO()):
        written, session = Path(name, "table.csv"), Path(name, "session.jsonl")
        written.write_text(table, encoding="utf-8")
        import_files([written], session, machine=None, resolution=resolution_mm)
        sessions, _ = load_sessions([session])
    (session_read,) = sessions
    return posterior([case_of(session_read, Model(session_read.opened.machine.geometry()))])


def judged(session: Session) -> dict[str, Any]:
    """Names, mistakes, and how far lengths and play are off, in standard uncertainties."""
    start = time.process_time()
    answer = posterior_of(session.table, session.resolution_mm)
    used_s = time.process_time() - start
    mean, covariance = in_field(answer)
    uncertainty = np.sqrt(np.maximum(covariance.diagonal(), 1e-300))
    truth = session.hidden.amounts
    bars_mm, bars_u = parameters_mm(answer)
    off = list((bars_mm[3:] - truth["length"]) / bars_u[3:])
    for effect, place in answer.field.columns:
        if effect.id == "backlash" and truth["lost"][LETTERS.index(place)]:
            (column,) = answer.field.columns[effect, place]
            off.append((mean[column] - truth["lost"][LETTERS.index(place)]) / uncertainty[column])
    mistakes = {f"{i}:{w}": p for (i, w), p in answer.mistakes.items() if p >= LISTED}
    return {
        "names": {f"{i}:{w}": p for (i, w), p in answer.places.items() if p >= LISTED},
        "mistakes": mistakes,
        "none": sum(model.weight for model in answer.models if not model.mistakes),
        "place": any(mistake.startswith(session.place) for mistake in mistakes if session.place),
        "shown": session.shown and bool(session.place),
        "off_u": np.abs(off).round(2).tolist(),
        "cpu_s": used_s,
    }


def in_field(answer: Posterior) -> tuple[FloatArray, FloatArray]:
    """Mean ``(6 + k,)`` and covariance over all models, lengths and sizes."""
    mean = answer.mean
    covariance_sum = np.zeros((len(mean), len(mean)))
    for model in answer.models_in_field:
        off = model.mean - mean
        covariance = model.inflated**2 * model.base + model.root @ model.root.T
        covariance_sum += model.weight * (covariance + np.outer(off, off))
    return mean, covariance_sum


def parameters_mm(answer: Posterior) -> tuple[FloatArray, FloatArray]:
    """Joint offsets and lengths ``(6,)`` over all models, and their standard uncertainties.

    What a bar is beyond its tolerance has a name, ``leg_length``; its length is both together.
    """
    mean, covariance = in_field(answer)
    together = np.eye(6, len(mean))
    for effect, place in answer.field.columns:
        if effect.id == "leg_length":
            together[3 + LETTERS.index(place), answer.field.columns[effect, place]] = 1.0
    return together @ mean, np.sqrt((together @ covariance @ together.T).diagonal())


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry of ``python -m tests.blind.nuisances``."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind.nuisances", description=__doc__)
    parser.add_argument("--seed", type=int, default=28)
    parser.add_argument("--count", type=int, default=6, help="sessions of each kind")
    parser.add_argument("--kinds", nargs="+", choices=[*KINDS], default=[*KINDS])
    parser.add_argument("--each", action="store_true", help="a line for each session")
    parser.add_argument("-o", "--output", type=Path, help="a page of all rows as well")
    options = parser.parse_args(arguments)
    print(HEAD)
    rows = []
    for kind in options.kinds:
        results = []
        for n in range(options.count):
            rng = np.random.default_rng([options.seed, [*KINDS].index(kind), n])
            session = KINDS[kind](PROCEDURES[n % len(PROCEDURES)], rng)
            results.append(judged(session))
            if options.each:
                print(n, session.place, results[-1], flush=True)
        rows.append(_row(kind, results))
        print(rows[-1], flush=True)
    if options.output:
        text = "\n".join([PAGE.format(seed=options.seed, count=options.count), HEAD, *rows, ""])
        options.output.write_text(text, encoding="utf-8")
    return 0


PAGE = """# Set-ups of a workshop

{count} simulated sessions of each kind (`python -m tests.blind.nuisances --count {count} -o
docs/nuisances.md`, seed {seed}), with joint offsets, bars and what the row names. An effect is
named from a probability of one half; a mistake, or "none", is listed from 5 %. Lengths are those of
bars; u: standard uncertainty. A first take within the play is judged where it differs from both
ends of the play by three standard deviations.
"""

HEAD = (
    "| kind | effect named | of time | none listed | the right mistake listed | only "
    "another listed | lengths and play within 2 u |\n"
    "|---|---|---|---|---|---|---|"
)


def _row(kind: str, results: Sequence[dict[str, Any]]) -> str:
    named = [
        {n.split(":")[0] for n, p in result["names"].items() if p >= 0.5} for result in results
    ]
    off = np.concatenate([result["off_u"] for result in results])
    visible = sum(result["shown"] for result in results)
    cells = (
        kind,
        sum(map(bool, named)),
        sum(bool(names & set(TIMED)) for names in named),
        sum(result["none"] >= LISTED for result in results),
        f"{sum(result['place'] for result in results if result['shown'])} of {visible}"
        if visible
        else "–",
        sum(bool(result["mistakes"]) and not result["place"] for result in results),
        f"{int((off <= 2.0).sum())} of {len(off)}",
    )
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    sys.exit(main())
