"""The page docs/resolving.md from followed trials."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

from tests.blind.effects import EFFECT_IDS
from tests.blind.scoring import EVIDENCE_FLOOR, Rate
from tests.blind.table import shown
from tests.blind.trials import Trial

BINS = ((0.0, 25.0), (25.0, 50.0), (50.0, 200.0), (200.0, float("inf")))
TARGET = 0.9

Hit = Callable[[Trial], bool]


def page(trials: Sequence[Trial], drawn: int, seed: int) -> str:
    """Markdown."""
    followed = [trial for trial in trials if trial.followed]
    promised = [trial for trial in followed if trial.expected >= EVIDENCE_FLOOR]
    parts = [
        _head(trials, followed, drawn, seed),
        _main(trials, followed, promised),
        _by_promise(followed),
        _by_effect(followed),
        _unresolved(trials),
    ]
    return "\n\n".join(parts) + "\n"


def rate_of(trials: Sequence[Trial], hit: Hit) -> Rate:
    """How many are a hit."""
    return Rate(sum(map(hit, trials)), len(trials))


def _head(trials: Sequence[Trial], followed: Sequence[Trial], drawn: int, seed: int) -> str:
    changed = Counter(_preparation(trial) for trial in followed)
    return (
        "# Does the proposed measurement resolve what stayed ambiguous?\n\n"
        "Made by `python -m tests.blind.resolving -o docs/resolving.md`. Sessions with one hidden "
        "effect of 1, 2 or 4 times the noise, simulated by `tests/blind/`.\nWhere the "
        "diagnosis is `ambiguous`, the proposed measurement is made on the same machine with\nnew "
        "mountings and noise, and both sessions are diagnosed together. "
        "*Resolved*: of the names to\nseparate at most one is left, and the truth is not lost. "
        "*Single*: one name is left, the right\none at the right place. In brackets: 95 % bounds "
        "(Clopper and Pearson) and sessions.\n\n"
        f"{drawn} sessions drawn, seed {seed}; {len(trials)} were ambiguous. "
        f"{len(followed)} had a proposal:\n{changed['nothing']} on the unchanged machine, "
        f"{changed['offset']} with a joint offset shifted, {changed['load']} with twice the weight."
    )


def _preparation(trial: Trial) -> str:
    proposal = trial.first["next_measurement"]
    if proposal["load"] != 1.0:
        return "load"
    return "offset" if any(proposal["entered_mm"]) else "nothing"


def _main(trials: Sequence[Trial], followed: Sequence[Trial], promised: Sequence[Trial]) -> str:
    resolved = rate_of(promised, Trial.resolved)
    verdict = "yes" if resolved.share >= TARGET else "**no**"
    lines = [
        "| what | target | found | kept |",
        "|---|---|---|---|",
        f"| resolved, where {EVIDENCE_FLOOR:g} noise variances or more are expected | ≥ 90 % | "
        f"{shown(resolved)} | {verdict} |",
        f"| resolved, every proposal | – | {shown(rate_of(followed, Trial.resolved))} | – |",
        f"| explained by a wrong name | – | {shown(rate_of(followed, Trial.wrong))} | – |",
        *(
            f"| single after {word}, every ambiguous session | – | "
            f"{shown(rate_of(trials, hit))} | – |"
            for word, hit in (
                ("one measurement", lambda trial: trial.single(1)),
                ("two", lambda trial: trial.single(2)),
            )
        ),
    ]
    return "\n".join(lines)


def _by_promise(followed: Sequence[Trial]) -> str:
    lines = [
        "## By what was expected",
        "",
        "| expected separation, noise variances | resolved | single |",
        "|---|---|---|",
    ]
    for low, high in BINS:
        group = [trial for trial in followed if low <= trial.expected < high]
        bounds = f"{low:g} … {high:g}" if high < float("inf") else f"{low:g} and more"
        lines.append(f"| {bounds} | {_both(group)} |")
    return "\n".join(lines)


def _by_effect(followed: Sequence[Trial]) -> str:
    lines = ["## By hidden effect", "", "| effect | resolved | single |", "|---|---|---|"]
    for effect in EFFECT_IDS:
        group = [trial for trial in followed if trial.hidden["id"] == effect]
        lines.append(f"| {effect} | {_both(group)} |")
    return "\n".join(lines)


def _both(group: Sequence[Trial]) -> str:
    resolved, single = rate_of(group, Trial.resolved), rate_of(group, lambda trial: trial.single(1))
    return f"{resolved.hits}/{resolved.count} | {single.hits}/{single.count}"


def _unresolved(trials: Sequence[Trial]) -> str:
    alike = Counter(_names(trial) for trial in trials if not trial.followed)
    lines = ["## What stayed open", "", "No measurement separates these (sessions):", ""]
    lines += [f"- {names}: {n}" for names, n in alike.most_common()]
    return "\n".join(lines)


def _names(trial: Trial) -> str:
    effect = trial.first["effects"][0]
    return ", ".join(sorted({name["id"] for name in (effect, *effect["indistinguishable_from"])}))
