"""The page docs/blind.md from scored sessions."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from tests.blind.baselines import BASELINES
from tests.blind.cases import BARS, STRENGTHS, plan
from tests.blind.effects import EFFECT_IDS
from tests.blind.noise import NOISES
from tests.blind.reliability import brier, reliability
from tests.blind.scoring import (
    NEARLY_INSIDE,
    Json,
    Rate,
    Scored,
    at_best,
    blunder_claimed,
    blunder_named,
    called_explained,
    coverage,
    detectable,
    exact,
    false_machine_name,
    false_name,
    joined,
    percentiles,
    placed_in_set,
    rate,
    separable,
    shrunk,
    single_name,
    truth_in_set,
    wrong_confident,
    wrong_name_or_place,
)

Choice = Callable[[Scored], bool]

MOST_WRONG = 7
"""Confident mistakes that the page lists, the commonest ones."""

EARLIER: dict[str, list[str]] = json.loads(
    Path(__file__).with_name("figures_84cc33a.json").read_text(encoding="utf-8")
)
"""What the judges before the posterior had in all 5,484 sessions of seed 11; each in both columns.

They looked for what is beside the catalogue only where they were asked to.
"""


@dataclass(frozen=True)
class Told:
    """Truths by session, rows of results and of baselines, and how they came about."""

    truths: dict[str, Json]
    rows: list[Json]
    baselines: list[Json]
    seed: int
    digest: str
    seconds: float
    not_drawn: Sequence[str] = ()
    note: str = ""

    @cached_property
    def scored(self) -> list[Scored]:
        return joined(self.truths, self.rows)

    def cell(self, *names: str) -> list[Scored]:
        """Sessions of these cells."""
        return [score for score in self.scored if score.cell in names]


@dataclass(frozen=True)
class Line:
    """One line of the table: what must hold, over which sessions, and its limit if it has one.

    ``poor_limit`` is that of zero-max-min, where it is another one.
    """

    what: str
    chosen: list[Scored]
    hit: Choice
    limit: float | None
    at_most: bool = False
    poor_limit: float | None = None

    def markdown(self) -> str:
        # A diagnosis that broke has missed what it should find, but earns nothing by silence.
        counted = [o for o in self.chosen if not (self.at_most and o.verdict == "error")]
        rich = rate((score for score in counted if score.rich), self.hit)
        poor = rate((score for score in counted if not score.rich), self.hit)
        sign, poor_limit = "≤" if self.at_most else "≥", self.poor_limit or self.limit
        limits = dict.fromkeys((self.limit, poor_limit))
        target = "; ".join(
            "–" if limit_value is None else f"{sign} {100 * limit_value:g}"
            for limit_value in limits
        )
        verdicts = self._holds(rich, self.limit), self._holds(poor, poor_limit)
        holds = "; ".join(dict.fromkeys(verdicts)) if self.limit is not None else "–"
        earlier = "; ".join(EARLIER.get(self.what, ("–",))).replace(" %", "")
        return f"| {self.what} | {target} | {brief(rich)} | {brief(poor)} | {holds} | {earlier} |"

    def _holds(self, figure: Rate, limit: float | None) -> str:
        if not figure.count or limit is None:
            return "–"
        good = figure.share <= limit if self.at_most else figure.share >= limit
        low, high = figure.bounds
        sure = high <= limit if self.at_most else low >= limit
        if good:
            return "yes, surely" if sure else "yes"
        excused = low <= limit if self.at_most else high >= limit
        return "not shown" if excused else "**no**"


def shown(figure: Rate) -> str:
    """Percentage with bounds and counts."""
    if not figure.count:
        return "–"
    low, high = figure.bounds
    return (
        f"{100 * figure.share:.1f} % ({100 * low:.1f} … {100 * high:.1f}; "
        f"{figure.hits}/{figure.count})"
    )


def brief(figure: Rate) -> str:
    """The same in short, %."""
    if not figure.count:
        return "–"
    low, high = figure.bounds
    bounds = f"({100 * low:.1f}–{100 * high:.1f})"
    return f"{100 * figure.share:.1f} {bounds}, {figure.hits}/{figure.count}"


def page(results: Told) -> str:
    """The whole page."""
    parts = [
        _head(results),
        _must_hold(results),
        _by_noise(results),
        _figures(results),
        _probabilities(results),
    ]
    parts += [_by_effect(results), _against_baselines(results), _wrong(results)]
    return "\n\n".join(parts) + "\n"


def _head(results: Told) -> str:
    unrun = sum(row["verdict"] == "not run" for row in results.rows)
    failed = sum(row["verdict"] == "error" for row in results.rows)
    return "\n".join(
        (
            "# The blind table",
            "",
            "`tests/blind/` draws sessions with hidden effects by a machine simulation of its own.",
            "They are diagnosed, and only then compared with the sealed truths (`make blind`).",
            "",
            f"- {len(results.scored)} of the {len(plan())} planned sessions, seed {results.seed};",
            f"  {unrun} not run for want of a way to leave an effect out; {failed} ended in error.",
            *[f"- Could not be drawn: {why}." for why in results.not_drawn],
            *([f"- {results.note}"] if results.note else []),
            f"- SHA-256 of the sealed truths: `{results.digest}`",
            f"- The last run took {results.seconds:.0f} s on two processes.",
            "",
            "Figures are in %, with 95 % bounds (Clopper and Pearson). Strength is the r.m.s. of",
            "an effect in the readings when base parameters and zeros are refitted, over the",
            "noise; of two effects without what the other can imitate. It is *separable* if its",
            "nearest rival misses it by at least 25 in χ². Lines of sets leave out effects below",
            "the strength that is found nine times in ten at 1 % over 100 candidates. Slow wander",
            "may be called thermal_drift. The ideal judge knows the machine, the noise and the",
            "other effect, and takes the name of the largest Bayes factor.",
        )
    )


def _must_hold(results: Told) -> str:
    lines = [line.markdown() for line in (*_false_lines(results), *_true_lines(results))]
    head = "| what | target | two-station and sweep | zero-max-min | kept | 84cc33a |\n"
    return "\n".join(("## What must hold", "", head + "|---|---|---|---|---|---|", *lines))


def _false_lines(results: Told) -> list[Line]:
    unknown = [o for o in results.cell("outside", "left-out") if _foreign(o)]
    in_library = ("none", "single", "pair", "look-alike", "blunder", "blunder-and-effect")
    return [
        Line("false name, no effect", results.cell("none"), false_name, 0.01, True),
        Line("wrong confident name", results.cell(*in_library), wrong_confident, 0.01, True),
        Line(
            "wrong confident name or place",
            results.cell(*in_library),
            wrong_name_or_place,
            0.01,
            True,
        ),
        Line("not in the catalogue, called explained", unknown, called_explained, 0.03, True, 0.05),
        Line(
            "the same, nearly imitated by a known effect",
            [o for o in results.cell("outside", "left-out") if not _foreign(o)],
            called_explained,
            None,
        ),
        Line(
            "beside the catalogue, wrong name or place",
            results.cell("beside", "beside-named"),
            wrong_name_or_place,
            None,
            True,
        ),
        *(
            Line(
                f"false machine name, bars off by {off:g} tolerances",
                [o for o in results.cell("bars") if o.truth["bars"] == off],
                false_machine_name,
                0.02,
                True,
            )
            for off in BARS
        ),
        Line("blunder claimed, no effect", results.cell("none"), blunder_claimed, 0.0, True),
        Line("over a plane: false name", results.cell("plane-none"), false_name, 0.01, True),
        Line(
            "over a plane: wrong confident name", results.cell("plane"), wrong_confident, 0.01, True
        ),
        Line(
            "over a plane alone: false name",
            results.cell("plane-alone-none"),
            false_name,
            0.01,
            True,
        ),
        Line(
            "over a plane alone: wrong confident name",
            results.cell("plane-alone"),
            wrong_confident,
            0.01,
            True,
        ),
        Line("false name, mislabelled repeats", results.cell("mislabelled"), false_name, None),
    ]


def _foreign(score: Scored) -> bool:
    return all(truth["rival_share"] < NEARLY_INSIDE for truth in score.hidden)


def _true_lines(results: Told) -> list[Line]:
    single = results.cell("single")
    large = [o for o in single if min(o.truth["strengths"]) >= 2]
    pairs = [o for o in results.cell("pair") if detectable(o)]
    return [
        Line("truth in the set", [o for o in single if detectable(o)], truth_in_set, 0.97),
        Line("the same, with its place", [o for o in single if detectable(o)], placed_in_set, None),
        Line(
            "beside the catalogue, in the set",
            results.cell("beside", "beside-named"),
            truth_in_set,
            None,
        ),
        Line(
            "single name and place, separable",
            [o for o in large if separable(o)],
            single_name,
            0.96,
        ),
        Line("the same, whether separable or not", large, single_name, None),
        Line("single effects, exact", large, exact, None),
        Line("two effects, both in the set", pairs, truth_in_set, 0.97, poor_limit=0.9),
        Line("the same, with their places", pairs, placed_in_set, None),
        Line("two effects, exact", pairs, exact, None),
        Line("two effects, exact, separable", [o for o in pairs if separable(o)], exact, 0.95),
        Line("look-alikes, truth in the set", results.cell("look-alike"), truth_in_set, 0.95),
        Line(
            "over a plane: truth in the set",
            [o for o in results.cell("plane") if detectable(o)],
            truth_in_set,
            0.95,
        ),
        Line(
            "over a plane: single name and place, separable",
            [o for o in results.cell("plane") if separable(o)],
            single_name,
            0.95,
        ),
        Line("blunder named with its place", results.cell("blunder"), blunder_named, 0.99),
        Line(
            "blunder named beside an effect",
            results.cell("blunder-and-effect"),
            blunder_named,
            0.99,
        ),
        Line(
            "the effect beside a blunder, in the set",
            results.cell("blunder-and-effect"),
            truth_in_set,
            0.95,
        ),
    ]


def _figures(results: Told) -> str:
    single = results.cell("single")
    large = [o for o in single if min(o.truth["strengths"]) >= 2]
    rows = ["## Figures", "", "| what | target | two-station and sweep | zero-max-min |"]
    rows.append("|---|---|---|---|")
    pairs = [o for o in results.cell("pair") if detectable(o)]
    rows.append(_split("single effects, exact, by an ideal judge", "–", large, _at_best))
    rows.append(_split("two effects, exact, by an ideal judge", "–", pairs, _at_best))
    rows.append(_split("parameter inside its 95 % interval", "≥ 93", single, _coverage))
    rows.append(_split("held-out gap over the true model's, median", "≤ 1.1", large, _held_out))
    rows.append(
        _split(
            "processor time inside one process, median and 95th", "≤ 0.25 s", results.scored, _times
        )
    )
    return "\n".join(rows)


def _probabilities(results: Told) -> str:
    """Reliability of the probabilities of names, and the Brier score."""
    in_library = results.cell("none", "single", "pair", "look-alike", "plane", "plane-alone")
    foreign = [score for score in results.cell("outside", "left-out") if _foreign(score)]
    stated, wrong = (
        {interval.least: interval for interval in reliability(score)}
        for score in (in_library, foreign)
    )
    rows = []
    for least in sorted(stated | wrong):
        highest = (stated | wrong)[least].most
        mean, right, count = "–", "–", 0
        if reliability_bin := stated.get(least):
            mean, right, count = (
                f"{reliability_bin.mean:.3f}",
                f"{reliability_bin.right:.3f}",
                reliability_bin.count,
            )
        outside = wrong[least].count if least in wrong else 0
        rows.append([f"{least:g}–{highest:g}", mean, right, f"{count}", f"{outside}"])
    scores = [
        f"Brier score of a session, {kind}: {score:.3f} ({len(sessions)} sessions)."
        for kind, sessions in (("hidden laws known", in_library), ("outside", foreign))
        if (score := brier(sessions)) is not None
    ]
    head = ["probability", "mean", "right", "names", "names where the law is outside"]
    return "\n\n".join([_grid("Probabilities of names", head, rows), *scores])


def _split(
    what: str, target: str, sessions: list[Scored], figure: Callable[[list[Scored]], str]
) -> str:
    rich = [score for score in sessions if score.rich]
    poor = [score for score in sessions if not score.rich]
    return f"| {what} | {target} | {figure(rich)} | {figure(poor)} |"


def _at_best(sessions: list[Scored]) -> str:
    shares = [at_best(score) for score in sessions]
    return f"{100 * sum(shares) / len(shares):.1f}" if shares else "–"


def _coverage(sessions: list[Scored]) -> str:
    return brief(coverage(sessions))


def _held_out(sessions: list[Scored]) -> str:
    values = shrunk(sessions)
    return f"{percentiles(values)[0]:.3f} ({len(values)} sessions)" if values else "–"


def _times(sessions: list[Scored]) -> str:
    """Time of the processor: other programs may use the cores as well."""
    median, high = percentiles([score.row["cpu_s"] for score in sessions])
    return f"{median:.2f} s, {high:.2f} s" if not math.isnan(median) else "–"


def _grid(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"## {title}", "", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def _by_noise(results: Told) -> str:
    rates = {
        noise: rate((o for o in results.cell("none") if o.truth["noise"] == noise), false_name)
        for noise in NOISES
    }
    counts = ", ".join(f"{noise} {figure.hits}/{figure.count}" for noise, figure in rates.items())
    return f"False names where nothing is hidden, by noise: {counts}."


def _by_effect(results: Told) -> str:
    """In the set / singly named, for every effect and strength; sweep and two-station."""
    rows = []
    for effect in EFFECT_IDS:
        cells = [effect]
        for strength in STRENGTHS:
            chosen = [
                score
                for score in results.cell("single")
                if score.rich
                and score.true_ids == {effect}
                and score.truth["strengths"] == [strength]
            ]
            cells.append(f"{_percent(chosen, truth_in_set)}/{_percent(chosen, single_name)}")
        rows.append(cells)
    head = ["effect: in the set/single name and place", *(f"{k:g} ×" for k in STRENGTHS)]
    return _grid("Single effects, two-station and sweep", head, rows)


def _percent(sessions: list[Scored], hit: Choice) -> str:
    figure = rate(sessions, hit)
    return f"{100 * figure.share:.0f}" if figure.count else "–"


def _against_baselines(results: Told) -> str:
    """False names, exact names and names for the unknown: baselines and diagnosis, same cases."""
    by_session = {row["session"]: row["named"] for row in results.baselines}
    common = [score for score in results.scored if score.row["session"] in by_session]
    rows = []
    for name in (*BASELINES, "glidecal"):
        answers = {
            score.row["session"]: score.named_ids
            if name == "glidecal"
            else set(by_session[score.row["session"]][name])
            for score in common
        }
        rows.append([name, *_compared(common, answers)])
    head = ["method", "false name", "exact, single ≥ 1 ×", "exact, pairs", "names the unknown"]
    return _grid("Beside simpler methods, same sessions", head, rows)


def _compared(common: list[Scored], answers: dict[str, set[str]]) -> list[str]:
    def names(score: Scored) -> bool:
        return bool(answers[score.row["session"]])

    def right(score: Scored) -> bool:
        return answers[score.row["session"]] == score.true_ids

    scored = [o for o in common if o.cell == "none" and o.truth["noise"] != "wander"]
    single = [o for o in common if o.cell == "single" and o.truth["strengths"][0] >= 1]
    pairs = [o for o in common if o.cell == "pair"]
    outside = [o for o in common if o.cell == "outside"]
    return [
        brief(rate(scored, names)),
        brief(rate(single, right)),
        brief(rate(pairs, right)),
        brief(rate(outside, names)),
    ]


def _wrong(results: Told) -> str:
    """The commonest confident mistakes, to work on."""
    counts = Counter(
        (
            score.cell,
            score.truth["procedure"],
            ", ".join(sorted(score.true_ids)) or "–",
            ", ".join(sorted(score.named_ids)),
        )
        for score in results.scored
        if wrong_confident(score)
    )
    rows = [[*key, str(count)] for key, count in counts.most_common(MOST_WRONG)]
    return _grid("Wrong confident names", ["cell", "procedure", "truth", "named", "times"], rows)
