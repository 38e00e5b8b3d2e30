"""Sessions with hidden effects: a table of readings without a trace of the truth, and the truth."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from tests.blind import blunders
from tests.blind.cases import Case
from tests.blind.effects import (
    LARGEST,
    LETTERS,
    PAIRS,
    Candidate,
    Direction,
    beside,
    candidates,
    everywhere,
    rivals,
)
from tests.blind.forward import FloatArray, Hidden, Hypothesis, Rows, readings
from tests.blind.noise import RESOLUTION_MM, Noise, draw
from tests.blind.signatures import (
    BASE,
    Columns,
    best_rival,
    contained,
    left_out_rms,
    named_by_a_judge,
    parts,
)
from tests.blind.steps import PLANS, Visit, rows_of, rows_of_visits, sorted_by_cycle

Json = dict[str, Any]
Change = tuple[Hypothesis, float]

OFFSET_LIMIT_MM = 2.0
LENGTH_SPREAD_MM = 0.03
LENGTH_TOLERANCE_MM = 0.1  # of the machine file
TOLD_APART = 9.0  # noise variances below which two places are one for these readings
ZERO_LIMIT_MM = 0.5
TILT_LIMIT = 2e-3  # of a plane under a leg
AROUND = ((2, 0), (0, 1), (1, 2))  # pairs of axes, each from one to the next
TRIES = 400
SEEN = 1e-7  # an effect whose columns vanish is drawn again at another place

SHAPE_ENTRIES = {"cubic": "cubic", "sawtooth": "saw"}


class NotDrawn(ValueError):
    """No draw of a case gave a machine that a workshop could have."""


@dataclass(frozen=True)
class Made:
    """One session: the table as text, the indicators' resolution, and what scoring may know.

    The truth costs more than the session and is worked out where it is asked for. ``rows`` and
    ``values_mm`` hold what the table says, for the baselines. ``hidden`` is the machine and
    ``sigma_mm`` the scatter of one reading, for measuring it again.
    """

    table: str
    resolution_mm: float | None
    tell: Callable[[], Json]
    rows: Rows
    values_mm: FloatArray
    hidden: Hidden
    sigma_mm: float

    @cached_property
    def truth(self) -> Json:
        return self.tell()


@dataclass(frozen=True, eq=False)
class EffectInstance:
    """One hidden effect: changes of the machine and what they leave in the readings."""

    candidate: Candidate
    changes: list[Change]
    signal: FloatArray
    lead_mm: float


def make(case: Case, seed: int) -> Made:
    """The session of a case; the same for the same seed. Raises NotDrawn where none comes out."""
    rng = case.generator(seed)
    for _ in range(TRIES):
        try:
            return _attempt(case, rng)
        except ValueError:
            continue
    raise NotDrawn(f"{case.key}: no session in {TRIES} draws")


def _attempt(case: Case, rng: np.random.Generator) -> Made:
    rows = rows_of(PLANS[case.procedure], rng, case.noise == "locked", case.homed)
    sigma_mm = float(rng.uniform(0.0007, 0.0015) if case.noise == "quantised" else scatter_mm(rng))
    noise = draw(case.noise, rows, sigma_mm, rng)
    hidden, columns = _machine(case, rows, rng)
    placed = [
        _placed(case, effect, k * noise.rms_mm, columns, rng)
        for effect, k in zip(case.effects or _shapes(case), case.strengths, strict=True)
    ]
    for instance in placed:
        hidden = Hidden(
            hidden.plus(instance.changes).amounts, instance.lead_mm, *settings_of(hidden)
        )
    table, where = _table(case, rows, hidden, noise, rng)
    tell = partial(_truth, case, columns, placed, noise, where)
    text = table_text(table, noise.resolution_mm)
    return Made(text, noise.resolution_mm, tell, table.rows, table.values_mm, hidden, sigma_mm)


@dataclass(frozen=True)
class Again:
    """The same machine once more: visits, what was added to entered offsets, and the load."""

    taken: list[Visit]
    entered_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    load: float = 1.0


def made_again(session: Made, again: Again, noise_kind: str, rng: np.random.Generator) -> Made:
    """New mountings, new noise of the same kind; an offset that is entered is gone."""
    rows = rows_of_visits(again.taken, rng)
    noise = draw(noise_kind, rows, session.sigma_mm, rng)
    zeros = rng.uniform(-ZERO_LIMIT_MM, ZERO_LIMIT_MM, rows.mount.max() + 1)
    less = [(("offset", (leg,)), -change) for leg, change in enumerate(again.entered_mm)]
    sag = session.hidden.amounts["sag"]
    heavier = [(("sag", (leg,)), (again.load - 1.0) * float(sag[leg])) for leg in range(3)]
    plain = session.hidden
    hidden = Hidden(plain.plus([*less, *heavier]).amounts, plain.lead_mm, *settings_of(plain))
    values = readings(rows, hidden) + zeros[rows.mount] + noise.values_mm
    text = table_text(blunders.Table(rows, values), noise.resolution_mm)
    return replace(
        session, table=text, resolution_mm=noise.resolution_mm, rows=rows, values_mm=values
    )


def scatter_mm(rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(0.0008), np.log(0.003))))


def settings_of(hidden: Hidden) -> tuple[float, tuple[tuple[float, float], ...]]:
    return hidden.saw_period_mm, hidden.waves


def _shapes(case: Case) -> tuple[str, ...]:
    return (case.shape,) if case.shape else ()


def _machine(case: Case, rows: Rows, rng: np.random.Generator) -> tuple[Hidden, Columns]:
    """A machine with its own offsets and lengths, and the derivatives there."""
    offsets = rng.uniform(-OFFSET_LIMIT_MM, OFFSET_LIMIT_MM, 3)
    lengths = LENGTH_SPREAD_MM * rng.standard_normal(3)
    if case.bars:
        lengths = case.bars * LENGTH_TOLERANCE_MM * rng.choice([-1.0, 1.0], 3)
    drawn = zip(BASE, [*offsets, *lengths], strict=True)
    base = Hidden().plus([(entry, float(amount)) for entry, amount in drawn])
    if rows.over_plane.any():
        base.amounts["plane"][:2, 2] = rng.uniform(-TILT_LIMIT, TILT_LIMIT, 2)
    waves = tuple((float(rng.uniform(0.03, 0.09)), float(rng.uniform(0, 6.3))) for _ in range(3))
    hidden = Hidden(base.amounts, 5.0, float(rng.uniform(17.0, 45.0)), waves)
    return hidden, Columns(rows, hidden)


def _placed(
    case: Case, effect: str, size_mm: float, columns: Columns, rng: np.random.Generator
) -> EffectInstance:
    """The effect at a drawn place with r.m.s. ``size_mm`` after base and zeros are refitted."""
    candidate = drawn_outside(effect, rng) if case.shape else drawn_place(effect, rng)
    residual = columns.left_over(columns.raw(candidate))
    visible = np.linalg.norm(residual, axis=0)
    if np.any(visible < SEEN):
        raise ValueError("this place cannot be seen")
    weights = rng.standard_normal(len(visible)) / visible
    if candidate.id in ("backlash", "gravity_sag", "joint_clearance", "gauge_hysteresis"):
        weights = np.abs(weights)
    weights *= size_mm / _rms(residual @ weights)
    for _ in range(5):  # the effect itself may be nonlinear
        changes = changes_of(candidate.directions, weights, rng)
        signal = _signal(columns, candidate, changes)
        weights *= size_mm / _rms(signal)
    check_size(changes)
    return EffectInstance(candidate, changes, signal, candidate.lead_mm)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def drawn_place(effect: str, rng: np.random.Generator) -> Candidate:
    """A place for the effect: mostly one leg, axis or mounting, sometimes all alike."""
    variants = [c for c in (*candidates(), *beside()) if c.id == effect]
    single = [c for c in variants if c.where != "all"]
    together = [c for c in variants if c.where == "all"]
    if effect in ("thermal_drift", "gravity_sag"):
        single, together = (together, single) if rng.random() < 0.5 else (single, together)
    places = together if not single or (together and rng.random() < 0.2) else single
    return places[int(rng.integers(len(places)))]


def place_share(candidate: Candidate) -> float:
    """How often `drawn_place` takes this place for its effect, of 1."""
    alike = [c for c in (*candidates(), *beside()) if c.id == candidate.id]
    like_it = [c for c in alike if (c.where == "all") == (candidate.where == "all")]
    if len(like_it) == len(alike):
        return 1.0 / len(like_it)
    everywhere = 0.5 if candidate.id in ("thermal_drift", "gravity_sag") else 0.2
    share = everywhere if candidate.where == "all" else 1.0 - everywhere
    return share / len(like_it)


def drawn_outside(shape: str, rng: np.random.Generator) -> Candidate:
    leg = int(rng.integers(3))
    side = (leg + int(rng.integers(1, 3))) % 3
    index = (leg,) if shape in SHAPE_ENTRIES else (leg, side)
    entry = SHAPE_ENTRIES.get(shape, shape)
    return Candidate(shape, LETTERS[leg], ((((entry, index), 1.0),),))


def changes_of(
    directions: tuple[Direction, ...], weights: FloatArray, rng: np.random.Generator
) -> list[Change]:
    amounts: dict[Hypothesis, float] = {}
    for direction, weight in zip(directions, weights, strict=True):
        for entry, part in direction:
            amounts[entry] = amounts.get(entry, 0.0) + part * float(weight)
    return [change for entry, amount in amounts.items() for change in _shared(entry, amount, rng)]


def _shared(entry: Hypothesis, amount: float, rng: np.random.Generator) -> list[Change]:
    """Squareness of a pair: which of the two axes leans cannot be seen, so both do."""
    if entry[0] != "lean":
        return [(entry, amount)]
    part = float(rng.uniform(0.2, 0.8))
    i, j = entry[1]
    return [(("lean", (i, j)), part * amount), (("lean", (j, i)), (1 - part) * amount)]


def _signal(columns: Columns, candidate: Candidate, changes: list[Change]) -> FloatArray:
    """What the effect leaves in the readings, computed without linearising it."""
    plain = columns.hidden
    machine = Hidden(plain.plus(changes).amounts, candidate.lead_mm, *settings_of(plain))
    return columns.left_over(readings(columns.rows, machine) - readings(columns.rows, plain))


def check_size(changes: list[Change]) -> None:
    for (name, _), amount in changes:
        if abs(amount) > LARGEST.get(name, np.inf):
            raise ValueError(f"{name} of {amount:g} is larger than any workshop would have")


def _table(
    case: Case, rows: Rows, hidden: Hidden, noise: Noise, rng: np.random.Generator
) -> tuple[blunders.Table, tuple[str, ...]]:
    """The readings as written down, and where the blunder sits."""
    zeros = rng.uniform(-ZERO_LIMIT_MM, ZERO_LIMIT_MM, rows.mount.max() + 1)
    values = readings(rows, hidden) + zeros[rows.mount] + noise.values_mm
    table = blunders.Table(rows, values)
    if case.cell == "mislabelled":
        order = np.lexsort((np.arange(len(rows)), rows.cycle, rows.station < 0.5, rows.leg))
        table = blunders.Table(sorted_by_cycle(rows), values[order])
    if not case.blunder:
        return table, ()
    table, place = blunders.commit(case.blunder, table, noise.rms_mm, rng)
    return table, place.where


def table_text(table: blunders.Table, resolution_mm: float | None) -> str:
    """The table of readings as CSV, in the order taken."""
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    head = ("leg", "axis", "displacement_mm", "value_mm", "cycle", "time_s", "station")
    rows = table.rows
    over = rows.over_plane
    writer.writerow((*head, *(("plane",) if over.any() else ())))
    steps = RESOLUTION_MM if resolution_mm else 1e-6
    display = np.round(table.values_mm / steps) * steps
    for k in range(len(rows)):
        writer.writerow(
            (
                LETTERS[rows.leg[k]],
                LETTERS[rows.axis[k]],
                f"{rows.displacement_mm[k]:g}",
                f"{display[k]:.6f}",
                int(rows.cycle[k]),
                f"{rows.time_s[k]:.1f}",
                f"{rows.station[k]:g}",
                *((int(over[k]),) if over.any() else ()),
            )
        )
    return lines.getvalue()


def _truth(
    case: Case,
    columns: Columns,
    placed: list[EffectInstance],
    noise: Noise,
    blunder_where: tuple[str, ...],
) -> Json:
    amounts = columns.hidden.amounts
    return {
        **asdict(case),
        "readings": len(columns.rows),
        "noise_rms_mm": noise.rms_mm,
        "offsets_mm": amounts["offset"].tolist(),
        "lengths_mm": amounts["length"].tolist(),
        "hidden": [
            _described(effect, case, _beside(effect, placed, columns), noise.rms_mm)
            for effect in placed
        ],
        "blunder_where": list(blunder_where),
        "left_by_true_model_mm": _oracle_mm(columns, placed, noise),
    }


def _beside(instance: EffectInstance, placed: list[EffectInstance], columns: Columns) -> Columns:
    """Of two effects each counts for what the other cannot take over."""
    return columns.beside([effect.candidate for effect in placed if effect is not instance])


def _described(placed: EffectInstance, case: Case, columns: Columns, noise_mm: float) -> Json:
    candidate = placed.candidate
    # With no blunder tested all that is looked for competes, but for what was left out of it.
    laws = [*rivals(), *beside(), everywhere()]
    alternatives = [c for c in laws if c.id != candidate.id and c.id not in case.without]
    rival, share = best_rival(columns, placed.signal, alternatives)
    parameters = len(candidate.directions)
    signal = columns.left_over(placed.signal)
    alike = [c for c in laws if c.id == candidate.id and c.where != candidate.where]
    alternatives = [c for c in alike if len(c.directions) <= parameters]
    alternatives += parts(candidate)
    elsewhere = [contained(signal, columns.span(c)) for c in alternatives]
    ncp = float(np.sum((signal / noise_mm) ** 2))
    eligible = [c for c in laws if c.id not in case.without or c.id == candidate.id]
    eligible = eligible if candidate.id in {c.id for c in eligible} else [*eligible, candidate]
    shared = {c.where for c in alike if (1 - contained(signal, columns.span(c))) * ncp < TOLD_APART}
    return {
        "id": candidate.id,
        "where": [candidate.where, *_also_right(placed)],
        "where_alike": sorted(shared),
        "parameters": [
            {"entry": name, "index": list(index), "value": amount}
            for (name, index), amount in _public(placed.changes)
        ],
        "lead_mm": placed.lead_mm,
        "count": parameters,
        "ncp": ncp,
        "rms_mm": _rms(placed.signal),
        "rival": rival,
        "rival_share": share,
        "rival_ncp": (1 - share) * ncp,
        "named_by_a_judge": named_by_a_judge(
            columns, placed.signal, candidate.id, eligible, noise_mm
        ),
        "elsewhere_ncp": (1 - max(elsewhere, default=0.0)) * ncp,
    }


def _also_right(placed: EffectInstance) -> list[str]:
    """What goes one way across one axis or bar may be told as that axis or bar, or as that way.

    Of a shift readings see the distance to a third axis: its way is no place.
    """
    one_way = ("shift", "curve", "taper", "bow", "s_guide")
    places = {(name, index) for (name, index), _ in placed.changes if name in one_way}
    if len(places) != 1:
        return []
    ((name, (axis, side)),) = places
    names = {LETTERS[axis]} | ({LETTERS[axis] + LETTERS[side]} if name != "shift" else set())
    return sorted(names - {placed.candidate.where})


def _public(changes: list[Change]) -> list[Change]:
    """What a diagnosis can know: of the leans the sum of each pair, of shifts the distances."""
    leans: list[Change] = [(("lean", pair), _lean_sum(changes, pair)) for pair in PAIRS]
    shifts = {index: amount for (name, index), amount in changes if name == "shift"}
    distances: list[Change] = [
        (("distance", (i, j)), shifts.get((i, 3 - i - j), 0.0) - shifts.get((j, 3 - i - j), 0.0))
        for i, j in AROUND
    ]
    visible = [change for change in [*leans, *distances] if change[1]]
    return visible + [change for change in changes if change[0][0] not in ("lean", "shift")]


def _lean_sum(changes: list[Change], pair: tuple[int, int]) -> float:
    return sum(
        amount for (name, index), amount in changes if name == "lean" and set(index) == set(pair)
    )


def _oracle_mm(columns: Columns, placed: list[EffectInstance], noise: Noise) -> float:
    """R.m.s. of one side of one leg left out, where the true effects are fitted to the rest."""
    design = np.column_stack([columns.base, *(columns.raw(p.candidate) for p in placed)])
    rows = columns.rows
    sides = np.sign(rows.displacement_mm)
    groups = [
        (leg, side) if side else None
        for leg, side in zip(rows.leg.tolist(), sides.tolist(), strict=True)
    ]
    return left_out_rms(design, noise.values_mm, groups)
