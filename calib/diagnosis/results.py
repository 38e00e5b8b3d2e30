"""What a diagnosis gives: frozen results, no behaviour."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from calib.arrays import IntArray, Observations
from calib.quantity import INTERNAL, Internal, Quantity
from calib.tripod.effects.effect import EffectInstance

Verdict = Literal[
    "agrees", "explained", "ambiguous", "partly-explained", "unexplained", "cannot-tell"
]


Effects = Annotated[tuple[EffectInstance, ...], Internal()]


@dataclass(frozen=True)
class Gap:
    """What the model leaves of the readings that is not scatter of repeats.

    ``rms_mm`` is its size among the readings, noise included; ``chi_square`` is in noise
    variances.
    """

    rms_mm: float
    chi_square: float
    degrees_of_freedom: int
    p_value: float


@dataclass(frozen=True)
class GapPart:
    """A part of the gap: which leg, axis or pattern, its share and its chance."""

    leg: str | None
    axis: str | None
    posture_or_pattern: str
    share: float
    p_value: float


@dataclass(frozen=True, order=True)
class EffectName:
    """An effect's name and place."""

    id: str
    where: str


@dataclass(frozen=True)
class LikelyName:
    """A name with the probability that it acts anywhere."""

    id: str
    probability: float


@dataclass(frozen=True)
class Value:
    """One parameter of an effect."""

    name: str
    value: float
    standard_uncertainty: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """An effect or a gross error that was named, and what adopting it does to the gap.

    A ``where`` with commas lists legs or places that have values of their own.
    """

    id: str
    kind: str
    title: str
    where: str
    parameters: tuple[Value, ...]
    probability: Annotated[float, Quantity(words="of this name at this place")]
    gap_rms_before_mm: float
    gap_rms_after_mm: float
    indistinguishable_from: tuple[EffectName, ...] = ()
    effects: Effects = field(default=(), repr=False, metadata=INTERNAL)

    @property
    def lowers_the_gap(self) -> bool:
        """Whether less is left with it than without."""
        return self.gap_rms_after_mm < self.gap_rms_before_mm


@dataclass(frozen=True)
class ModelDiscrepancy(Finding):
    """What is left without a name, as an unnamed law; beside it the gap that it did not see."""

    held_out_gap: HeldOutGap | None = None


@dataclass(frozen=True)
class Contender:
    """An effect and place that may act, and why it is not named."""

    id: str
    where: str
    parameters: tuple[Value, ...]
    probability: Annotated[
        float, Quantity(words="of this name at this place, whatever acts beside it")
    ]
    gap_rms_after_mm: float
    # the part of the gap's square that it takes away alone, between 0 and 1
    explained: float = field(metadata=INTERNAL)
    held_out_gap_rms_mm: float | None
    reason_rejected: str
    effects: Effects = field(default=(), repr=False, metadata=INTERNAL)


@dataclass(frozen=True)
class HeldOutGap:
    """The gap on readings that the choice did not see, r.m.s. in mm."""

    how: str
    before_rms_mm: float
    after_rms_mm: float
    noise_rms_mm: float


@dataclass(frozen=True)
class Detectable:
    """The size of an effect that would have been found nine times of ten."""

    id: Annotated[
        str, Quantity("would have been found", words="an effect that the readings would have shown")
    ]
    size: Annotated[
        float,
        Quantity(
            "from", kind="two-digit", words="the size that would have been found nine times of ten"
        ),
    ]
    unit: Annotated[str, Quantity("", words="unit of the size")]


SEEN = 2.0
"""Standard deviations of a mean beyond which it is more than noise."""


@dataclass(frozen=True)
class Cell:
    """The mean residual of one leg, axis, station, displacement and side of approach, in mm.

    One of the tool has a ``position_mm`` and no displacement or side.
    ``after_mm`` is None where nothing was named that could be adopted. ``noise_mm`` is the
    standard deviation of the mean.
    """

    leg: str
    axis: str
    station: float
    displacement_mm: float
    approach: int
    before_mm: float
    after_mm: float | None
    noise_mm: float
    position_mm: tuple[float, ...] | None = None

    @property
    def strength(self) -> float:
        """The residual before, in standard deviations of its mean."""
        return self.before_mm / self.noise_mm


@dataclass(frozen=True)
class CellResiduals:
    """Mean residuals of the readings as they were diagnosed, offsets, lengths and zeros fitted.

    Mistakes that were found are corrected or left out. The r.m.s. are over the cells, that after
    None where they have none.
    """

    cells: tuple[Cell, ...]
    before_rms_mm: float
    after_rms_mm: float | None
    noise_rms_mm: float


@dataclass(frozen=True, eq=False)
class CleanedReadings:
    """Readings of one session without the mistakes found; ``rows`` ``(n,)`` are where they stood.

    A row that is not named was left out. ``slips`` ``(n,)`` counts how often its stand had moved.
    """

    observations: Observations
    rows: IntArray
    slips: IntArray


@dataclass(frozen=True)
class PatternPair:
    """What is left of session ``second`` without the pattern of ``first``, made ``scale`` as large.

    Sessions by their numbers from 0, held-out ones after the others. R.m.s. of the means of common
    postures, ``noise_rms_mm`` what noise alone would leave; ``p_value`` that it leaves the rest.
    """

    first: int
    second: int
    cosine: float
    scale: float
    before_rms_mm: float
    after_rms_mm: float
    noise_rms_mm: float
    p_value: float


@dataclass(frozen=True)
class SharedPattern:
    """How alike what is left of several sessions is, in so many free ``directions``.

    ``common_share`` of the patterns, made equally long, is one direction; the p-values are its
    chance with random directions, and with set-ups that change places.
    """

    sessions: tuple[int, ...]
    directions: int
    common_share: float
    p_value_directions: float
    p_value_permutations: float
    reproducible: bool
    pairs: tuple[PatternPair, ...]


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer. ``sentence`` is the verdict for a machinist.

    ``missing`` is the probability that anything is missing, ``something_else`` that something
    without a name acts, ``names`` are those that may act anywhere. ``not_shown`` are ids of effects
    that these readings would show of no size that a machine may have. ``cleaned`` are the readings
    of each session as they were diagnosed.
    """

    verdict: Verdict
    sentence: str
    missing: float
    something_else: float
    names: tuple[LikelyName, ...]
    gap_before: Gap
    gap_after: Gap
    held_out: HeldOutGap | None
    where: tuple[GapPart, ...]
    effects: tuple[Finding, ...]
    candidates: tuple[Contender, ...]
    smallest_detectable: tuple[Detectable, ...]
    not_shown: tuple[str, ...]
    residuals: CellResiduals
    remarks: tuple[str, ...] = ()
    left_over: ModelDiscrepancy | None = None
    pattern: SharedPattern | None = None
    cleaned: tuple[CleanedReadings, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Imitation:
    """How well one effect is imitated by another.

    Below 9 noise variances they cannot be told apart, above 25 they can.
    """

    effect: EffectName
    by: EffectName
    contained: Annotated[float, Quantity(words="1: they cannot be separated")]
    left_in_noise_variances: Annotated[float, Quantity(words="of an unremarkable size")]


@dataclass(frozen=True)
class AliasMap:
    """Imitations that matter, in both directions, and effects that no reading shows."""

    effects: tuple[EffectName, ...]
    imitations: tuple[Imitation, ...]
    invisible: tuple[EffectName, ...]
