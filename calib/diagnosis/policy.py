"""The numbers that decide what the diagnosis names, claims and calls a mistake, in one place.

How far a search looks (`PAIRS_AMONG`, `DRAWS`) and what belongs to one shape of one mistake only
(the slope of inches, the step of a stand) stand there; cuts of ranks in `calib.arrays`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeVar

Number = TypeVar("Number", int, float)


def _choice(value: Number, unit: str, decides: str, reason: str) -> Number:
    return field(default=value, metadata={"unit": unit, "decides": decides, "reason": reason})


@dataclass(frozen=True)
class Policy:
    """The choices. Each was tried on blind sessions; docs/diagnosis.md has a table of them."""

    agreement_level: float = _choice(
        0.01, "chance", "a gap counts below it", "one sound session in a hundred may be looked at"
    )
    naming_level: float = _choice(
        0.005,
        "chance",
        "an effect or a law is named below it",
        "half of the level of a gap, for noise is never quite normal",
    )
    credible_share: float = _choice(
        0.95, "share of the weight", "held by the set of models", "the usual one"
    )
    told_apart: float = _choice(
        9.0,
        "noise variances",
        "between two names, of the better fit; a surplus over the derivatives that is followed",
        "two that are apart by D change places by 9 at most once in 700 times, whatever D is",
    )
    decisive: float = _choice(
        25.0,
        "noise variances",
        "evidence of a single name, of one mistake against another, of a next measurement",
        "5 standard deviations; below 4 single names were wrong once in 14 times",
    )
    alike: float = _choice(
        0.98, "share of directions", "two candidates are one", "8° between two directions"
    )
    beyond: float = _choice(
        7.0,
        "log weight",
        "ahead of an error of each posture's own; behind it a model counts for nothing",
        "1,000 to 1; of names that blind sessions can tell one in 30 is lost, at 10 one in 9",
    )
    room: int = _choice(
        4,
        "degrees of freedom",
        "of a session where nothing is missing, beside a law, of repeats that judge readings",
        "with fewer nothing could show",
    )
    least_freedom: int = _choice(
        10,
        "degrees of freedom",
        "of a gap with a name, of readings with wrong signs",
        "every value that is fitted takes one",
    )
    most_causes: int = _choice(
        3, "number", "of causes of a model, of mistakes of a kind", "any four fit any shape"
    )
    far: float = _choice(
        30.0,
        "unremarkable sizes",
        "standard deviation of the prior of a size",
        "who built a machine would have seen more",
    )
    odds: float = _choice(
        100.0,
        "ratio",
        "of a wrong sign, unit or pair of indicators against all that was tried",
        "readings are changed for it",
    )
    wild_sd: float = _choice(
        17.0,
        "standard deviations of a reading",
        "a wild reading",
        "none in 1,116 blind sessions without mistakes, heavy tails among them",
    )
    mislabelled_sd: float = _choice(
        13.0,
        "standard deviations of a reading",
        "a reading under a wrong label",
        "that it fits another place is a second coincidence",
    )
    shift_variances: float = _choice(
        60.0,
        "noise variances",
        "a stand that moved",
        "none in 1,116 blind sessions without mistakes, drift among them",
    )

    @property
    def doubtful_odds(self) -> float:
        """Half the evidence of `odds`: a mistake is named with what does almost as well."""
        return math.sqrt(self.odds)


POLICY = Policy()
