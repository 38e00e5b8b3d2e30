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
        found: list[Json] = self.truth["hidden"]
        return found

    @property
    def true_ids(self) -> set[str]:
        names = {each["id"] for each in self.hidden}
        return names | ({self.truth["blunder"]} - {""})

    @property
    def named(self) -> list[Json]:
        """Effects that were named; unnamed laws are no names."""
        return [each for each in self.row["effects"] if each["kind"] != "empirical"]

    @property
    def named_ids(self) -> set[str]:
        return {each["id"] for each in self.named}

    @property
    def possible_ids(self) -> set[str]:
        """Every name that the verdict leaves open."""
        return self.named_ids | {name for each in self.named for name in each["also"]}


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


def rate(chosen: Iterable[Scored], hit: Callable[[Scored], bool]) -> Rate:
    """How many of these sessions are a hit."""
    outcomes = [hit(each) for each in chosen]
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


def detectable(one: Scored) -> bool:
    return all(each["ncp"] >= detection_ncp(each["count"]) for each in one.hidden)


def separable(one: Scored) -> bool:
    """Whether these data can tell every hidden effect and its place from all others.

    A bar that is wrong across both directions is not told from one that is wrong across one of
    them where the other value is too small to show: places within its place count as others.
    """
    return all(
        min(each["rival_ncp"], each["elsewhere_ncp"]) >= EVIDENCE_FLOOR for each in one.hidden
    )


def false_name(one: Scored) -> bool:
    """Any name on data without effect; calling a slow wander a drift is not false."""
    allowed = {"thermal_drift"} if one.truth["noise"] == "wander" else set()
    return bool(one.named_ids - allowed)


def wrong_confident(one: Scored) -> bool:
    """Explained by a single name that is not there."""
    if one.verdict != "explained":
        return False
    allowed = {"thermal_drift"} if one.truth["noise"] == "wander" else set()
    return any(not each["also"] and not _is_true(one, each, allowed) for each in one.named)


def _is_true(one: Scored, effect: Json, allowed: set[str]) -> bool:
    """A wild reading has no name in the contract; a row under a wrong label is one, too."""
    single_row = one.truth["blunder"] in ("wild", "label_error") and effect["kind"] == "blunder"
    alike = single_row and same_place(effect["where"], one.truth["blunder_where"])
    return alike or effect["id"] in one.true_ids | allowed


def wrong_place(one: Scored) -> bool:
    """Explained by a single right name at a place that is not the right one."""
    if one.verdict != "explained":
        return False
    return any(
        not each["also"] and each["id"] == hidden["id"] and not _at_its_place(each["where"], hidden)
        for each in one.named
        for hidden in one.hidden
        if sum(other["id"] == each["id"] for other in one.hidden) == 1
    )


def wrong_name_or_place(one: Scored) -> bool:
    return wrong_confident(one) or wrong_place(one)


def _at_its_place(said: str, hidden: Json) -> bool:
    """The right place, one that these readings cannot tell from it, or a list that holds it."""
    right = [*places(hidden), *hidden.get("where_alike", ())]
    return same_place(said, right) or any(same_place(part, right) for part in said.split(","))


def placed_in_set(one: Scored) -> bool:
    """Every hidden effect among the names left open, at its place or one that holds it."""
    said = [(each["id"], each["where"]) for each in one.named]
    said += [tuple(rival) for each in one.named for rival in each["also_at"]]
    return all(
        any(name == hidden["id"] and _at_its_place(where, hidden) for name, where in said)
        for hidden in one.hidden
    )


def false_machine_name(one: Scored) -> bool:
    """Bars that are off taken for another effect of the machine."""
    return any(each["kind"] == "machine" and each["id"] != "leg_length" for each in one.named)


def called_explained(one: Scored) -> bool:
    """A shape from outside the catalogue passed off as one of the catalogue."""
    return one.verdict == "explained" and bool(one.named)


def truth_in_set(one: Scored) -> bool:
    return {each["id"] for each in one.hidden} <= one.possible_ids


def exact(one: Scored) -> bool:
    return one.named_ids == one.true_ids


def single_name(one: Scored) -> bool:
    """One name, the right one, at the right place, without a partner."""
    if one.verdict != "explained" or len(one.named) != 1 or not exact(one):
        return False
    said = one.named[0]
    return not said["also"] and same_place(said["where"], places(one.hidden[0]))


def places(hidden: Json) -> list[str]:
    """Right names of its place. The contract's "all" is one value for all of them: where every
    place hides a value of its own, a list of all legs says so, too.
    """
    amounts = [abs(p["value"]) for p in hidden["parameters"]]
    own = [a for k, a in enumerate(amounts) if not any(np.isclose(a, b) for b in amounts[:k])]
    apart = len({tuple(p["index"]) for p in hidden["parameters"]}) == len(own) > 1
    return [*hidden["where"], *(["x,y,z"] if apart and "all" in hidden["where"] else [])]


def blunder_named(one: Scored) -> bool:
    """The mistake by its name and place, or as an alias beside one; a wild reading by any name."""
    mistakes = [each for each in one.named if each["kind"] == "blunder"]
    named = [(each["id"], each["where"]) for each in mistakes]
    named += [(alias, where) for each in mistakes for alias, where in each["also_at"]]
    wanted = ROWS_ALONE if one.truth["blunder"] == "wild" else (one.truth["blunder"],)
    right = one.truth["blunder_where"]
    return any(name in wanted and same_place(where, right) for name, where in named)


def blunder_claimed(one: Scored) -> bool:
    return any(each["kind"] == "blunder" for each in one.named)


def same_place(said: str, right: Sequence[str]) -> bool:
    """Whether the place said is one of the right ones; stations and words around are ignored."""
    plain = said.lower().split("@")[0].removeprefix("leg ").removeprefix("mount ").strip()
    # "xy" is leg x, axis y for an indicator, but a pair of axes has no order.
    return plain in right


def shrunk(chosen: Iterable[Scored]) -> list[float]:
    """Held-out gap left by the diagnosis over what the true model leaves."""
    return [
        one.row["held_out"]["after_rms_mm"] / one.truth["left_by_true_model_mm"]
        for one in chosen
        if (one.row.get("held_out") or {}).get("after_rms_mm") and one.named
    ]


def coverage(chosen: Iterable[Scored]) -> Rate:
    """Parameters of rightly named effects whose 95 % interval holds the truth."""
    found = [
        inside
        for one in chosen
        for effect in one.named
        for truth in one.hidden
        if effect["id"] == truth["id"] and same_place(effect["where"], truth["where"])
        for inside in covered(effect, truth, one.row.get("noise_dof"))
    ]
    return Rate(sum(found), len(found))


def at_best(one: Scored) -> float:
    """Chance that an ideal judge names every effect right, see `signatures.named_by_a_judge`."""
    return float(np.prod([each["named_by_a_judge"] for each in one.hidden]))


def percentiles(values: Sequence[float]) -> tuple[float, float]:
    """Median and 95th percentile; NaN of nothing."""
    if not values:
        return float("nan"), float("nan")
    return float(np.median(values)), float(np.percentile(values, 95))
