"""Scores of the blind table: sealed truths beside what the diagnosis said."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from scipy import stats

from tests.blind.cases import RICH
from tests.blind.parameters import covered

Json = dict[str, Any]

# A rival is told apart where its misfit is worth this much; the reference names nothing below.
EVIDENCE_FLOOR = 25.0
CANDIDATES = 100  # effects times places: what a single p-value is charged for
ROWS_ALONE = ("wild_reading", "label_error", "stand_slip", "first_take", "unit_mixup", "gauge_sign")
"""Names of the contract and of the program for a single reading that is wrong."""
NEARLY_INSIDE = 0.7  # a shape of which a known effect explains more is no fair unknown


@dataclass(frozen=True)
class Scored:
    """One session: its truth and the row of results."""

    truth: Json
    row: Json

    @property
    def cell(self) -> str:
        return str(self.truth["cell"])

    @property
    def rich(self) -> bool:
        """Whether the procedure is more than Zero, Max, Min."""
        return self.truth["procedure"] in RICH

    @property
    def verdict(self) -> str:
        return str(self.row["verdict"])

    @property
    def hidden(self) -> list[Json]:
        effects: list[Json] = self.truth["hidden"]
        return effects

    @property
    def true_ids(self) -> set[str]:
        names = {effect["id"] for effect in self.hidden}
        return names | ({self.truth["blunder"]} - {""})

    @property
    def named(self) -> list[Json]:
        """Effects that were named; unnamed laws are no names."""
        return [effect for effect in self.row["effects"] if effect["kind"] != "empirical"]

    @property
    def named_ids(self) -> set[str]:
        return {effect["id"] for effect in self.named}

    @property
    def possible_ids(self) -> set[str]:
        """Every name that the verdict leaves open."""
        return self.named_ids | {name for effect in self.named for name in effect["also"]}


@dataclass(frozen=True)
class Rate:
    """``hits`` of ``count`` with the exact 95 % bounds of Clopper and Pearson."""

    hits: int
    count: int

    @property
    def share(self) -> float:
        return self.hits / self.count if self.count else float("nan")

    @property
    def bounds(self) -> tuple[float, float]:
        k, n = self.hits, self.count
        low = float(stats.beta.ppf(0.025, k, n - k + 1)) if k else 0.0
        high = float(stats.beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0
        return low, high


def rate(sessions: Iterable[Scored], hit: Callable[[Scored], bool]) -> Rate:
    """How many of these sessions are a hit."""
    outcomes = [hit(item) for item in sessions]
    return Rate(sum(outcomes), len(outcomes))


@cache
def detection_ncp(parameters: int) -> float:
    """Sum of squares over noise squared that is found nine times in ten at 1 % over all."""
    bar = stats.chi2.isf(0.01 / CANDIDATES, parameters)
    sizes = np.linspace(5.0, 120.0, 1151)
    return float(sizes[np.argmax(stats.ncx2.sf(bar, parameters, sizes) >= 0.9)])


def joined(truths: dict[str, Json], rows: Iterable[Json]) -> list[Scored]:
    """Truth and result of every session that was diagnosed."""
    return [
        Scored(truths[row["session"]], row)
        for row in rows
        if row["session"] in truths and row["verdict"] != "not run"
    ]


def detectable(score: Scored) -> bool:
    return all(truth["ncp"] >= detection_ncp(truth["count"]) for truth in score.hidden)


def separable(score: Scored) -> bool:
    """Whether these data can tell every hidden effect and its place from all others.

    A bar that is wrong across both directions is not told from one that is wrong across one of
    them where the other value is too small to show: places within its place count as others.
    """
    return all(
        min(truth["rival_ncp"], truth["elsewhere_ncp"]) >= EVIDENCE_FLOOR for truth in score.hidden
    )


def false_name(score: Scored) -> bool:
    """Any name on data without effect; calling a slow wander a drift is not false."""
    allowed = {"thermal_drift"} if score.truth["noise"] == "wander" else set()
    return bool(score.named_ids - allowed)


def wrong_confident(score: Scored) -> bool:
    """Explained by a single name that is not there."""
    if score.verdict != "explained":
        return False
    allowed = {"thermal_drift"} if score.truth["noise"] == "wander" else set()
    return any(
        not effect["also"] and not _is_true(score, effect, allowed) for effect in score.named
    )


def _is_true(score: Scored, effect: Json, allowed: set[str]) -> bool:
    """A wild reading has no name in the contract; a row under a wrong label is one, too."""
    single_row = score.truth["blunder"] in ("wild", "label_error") and effect["kind"] == "blunder"
    alike = single_row and same_place(effect["where"], score.truth["blunder_where"])
    return alike or effect["id"] in score.true_ids | allowed


def wrong_place(score: Scored) -> bool:
    """Explained by a single right name at a place that is not the right one."""
    if score.verdict != "explained":
        return False
    return any(
        not effect["also"]
        and effect["id"] == hidden["id"]
        and not _at_its_place(effect["where"], hidden)
        for effect in score.named
        for hidden in score.hidden
        if sum(truth["id"] == effect["id"] for truth in score.hidden) == 1
    )


def wrong_name_or_place(score: Scored) -> bool:
    return wrong_confident(score) or wrong_place(score)


def _at_its_place(place: str, hidden: Json) -> bool:
    """The right place, one that these readings cannot tell from it, or a list that holds it."""
    right = [*places(hidden), *hidden.get("where_alike", ())]
    return same_place(place, right) or any(same_place(part, right) for part in place.split(","))


def placed_in_set(score: Scored) -> bool:
    """Every hidden effect among the names left open, at its place or one that holds it."""
    claims = [(effect["id"], effect["where"]) for effect in score.named]
    claims += [tuple(rival) for effect in score.named for rival in effect["also_at"]]
    return all(
        any(name == hidden["id"] and _at_its_place(where, hidden) for name, where in claims)
        for hidden in score.hidden
    )


def false_machine_name(score: Scored) -> bool:
    """Bars that are off taken for another effect of the machine."""
    return any(
        effect["kind"] == "machine" and effect["id"] != "leg_length" for effect in score.named
    )


def called_explained(score: Scored) -> bool:
    """A shape from outside the catalogue passed off as one of the catalogue."""
    return score.verdict == "explained" and bool(score.named)


def truth_in_set(score: Scored) -> bool:
    return {truth["id"] for truth in score.hidden} <= score.possible_ids


def exact(score: Scored) -> bool:
    return score.named_ids == score.true_ids


def single_name(score: Scored) -> bool:
    """One name, the right one, at the right place, without a partner."""
    if score.verdict != "explained" or len(score.named) != 1 or not exact(score):
        return False
    effect = score.named[0]
    return not effect["also"] and same_place(effect["where"], places(score.hidden[0]))


def places(hidden: Json) -> list[str]:
    """Right names of its place. The contract's "all" is one value for all of them: where every
    place hides a value of its own, a list of all legs says so, too.
    """
    amounts = [abs(p["value"]) for p in hidden["parameters"]]
    distinct = [a for k, a in enumerate(amounts) if not any(np.isclose(a, b) for b in amounts[:k])]
    apart = len({tuple(p["index"]) for p in hidden["parameters"]}) == len(distinct) > 1
    return [*hidden["where"], *(["x,y,z"] if apart and "all" in hidden["where"] else [])]


def blunder_named(score: Scored) -> bool:
    """The mistake by its name and place, or as an alias beside one; a wild reading by any name."""
    mistakes = [effect for effect in score.named if effect["kind"] == "blunder"]
    ids = [(effect["id"], effect["where"]) for effect in mistakes]
    ids += [(alias, where) for effect in mistakes for alias, where in effect["also_at"]]
    allowed_names = ROWS_ALONE if score.truth["blunder"] == "wild" else (score.truth["blunder"],)
    right = score.truth["blunder_where"]
    return any(name in allowed_names and same_place(where, right) for name, where in ids)


def blunder_claimed(score: Scored) -> bool:
    return any(effect["kind"] == "blunder" for effect in score.named)


def same_place(place: str, right: Sequence[str]) -> bool:
    """Whether the place said is one of the right ones; stations and words around are ignored."""
    plain = place.lower().split("@")[0].removeprefix("leg ").removeprefix("mount ").strip()
    # "xy" is leg x, axis y for an indicator, but a pair of axes has no order.
    return plain in right


def shrunk(sessions: Iterable[Scored]) -> list[float]:
    """Held-out gap left by the diagnosis over what the true model leaves."""
    return [
        score.row["held_out"]["after_rms_mm"] / score.truth["left_by_true_model_mm"]
        for score in sessions
        if (score.row.get("held_out") or {}).get("after_rms_mm") and score.named
    ]


def coverage(sessions: Iterable[Scored]) -> Rate:
    """Parameters of rightly named effects whose 95 % interval holds the truth."""
    outcomes = [
        inside
        for score in sessions
        for effect in score.named
        for truth in score.hidden
        if effect["id"] == truth["id"] and same_place(effect["where"], truth["where"])
        for inside in covered(effect, truth, score.row.get("noise_dof"))
    ]
    return Rate(sum(outcomes), len(outcomes))


def at_best(score: Scored) -> float:
    """Chance that an ideal judge names every effect right, see `signatures.named_by_a_judge`."""
    return float(np.prod([truth["named_by_a_judge"] for truth in score.hidden]))


def percentiles(values: Sequence[float]) -> tuple[float, float]:
    """Median and 95th percentile; NaN of nothing."""
    if not values:
        return float("nan"), float("nan")
    return float(np.median(values)), float(np.percentile(values, 95))
