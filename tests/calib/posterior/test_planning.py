"""Proposed measurements are taken of machines drawn from the posterior: do they do what is said?"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pytest

from calib.arrays import joined, observe
from calib.posterior.cells import SessionCase
from calib.posterior.correction import Correction, Holds, correction
from calib.posterior.measurements import (
    FurtherMeasurement,
    MeasurementPreparation,
    Pace,
    candidates,
)
from calib.posterior.models import Posterior
from calib.posterior.planning import DECISIVE, Planner
from calib.posterior.posterior import posterior
from calib.posterior.tool import Frame
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model, measure
from protocols.procedure import Procedure, leg_number
from tests.calib.posterior.hidden_machines import SHORT, SWEEP, TWO_STATION, hidden, session
from tests.conftest import LONG, first_quick

NOISE_MM = 0.003

HIDDEN: list[list[EffectInstance]] = [
    [hidden("backlash", "x", 0.03)],
    [hidden("gravity_sag", "y", 0.3)],
    [hidden("leg_taper", "yz", 0.3)],
    [hidden("actuator_scale", "z", 0.5)],
    [],
]


def machine_drawn(result: Posterior, generator: np.random.Generator) -> Model:
    """A machine of the mixture; something else is not drawn."""
    weight = np.array([model.weight for model in result.models])
    model = result.models[int(generator.choice(len(weight), p=weight / weight.sum()))]
    values, at = model.mean.copy(), result.parameter_count
    values[: len(model.base)] += (
        model.inflated * model.base @ generator.standard_normal(len(model.base))
    )
    values += model.inflated * model.sizes @ generator.standard_normal(model.sizes.shape[1])
    effects: list[EffectInstance] = []
    for k in (*model.everywhere, *model.members):
        component = result.components[k]
        effects += component.effects(values[at : at + len(component.unit)])
        at += len(component.unit)
    parameters = np.concatenate([values[3:6], values[:3]])
    return Model(parameters_mm=tuple(parameters.tolist()), effects=tuple(effects))


def with_reading_of(
    case: SessionCase, candidate: FurtherMeasurement, machine: Model, generator: np.random.Generator
) -> SessionCase:
    """The session with what a candidate reads of a machine, its mountings being further ones."""
    parts = [case.observations]
    for set_up in candidate.taken:
        value_mm = measure(
            machine, set_up, scatter_mm=NOISE_MM, resolution_mm=0.0, generator=generator
        )
        parts.append(observe(set_up, value_mm))
    together = replace(joined(parts), indicator=np.zeros(sum(map(len, parts)), dtype=np.intp))
    return replace(
        case,
        observations=observe(
            together, np.concatenate([observations.value_mm for observations in parts])
        ),
    )


@dataclass(frozen=True, eq=False)
class Trial:
    """A session, what is entered from it, and what is proposed."""

    case: SessionCase
    holds: Holds
    generator: np.random.Generator

    @classmethod
    def of(cls, number: int, holds: Holds) -> Trial:
        """Session of a number; its indicator is one, so that its noise is that of all."""
        effects = HIDDEN[number % len(HIDDEN)]
        case, _ = session(SHORT, *effects, seed=number, scatter_mm=NOISE_MM)
        zeros = np.zeros(len(case.observations), dtype=np.intp)
        case = replace(case, observations=replace(case.observations, indicator=zeros))
        return cls(case, holds, np.random.default_rng(100 + number))

    @cached_property
    def planner(self) -> Planner:
        """With set-ups of one leg and all, over the whole way at two stations."""
        result = posterior([self.case])
        subset = [
            proposal
            for proposal in candidates(result)
            if proposal.cycles == 1
            and proposal.station in (0.2, 0.8)
            and not proposal.preparation.words
        ]
        return Planner(result, self.entered(result), tuple(subset))

    def entered(self, result: Posterior) -> Correction:
        """From a posterior, in the usual frame."""
        return correction(result, self.holds)

    def bound_after_mm(self, candidate: FurtherMeasurement, machine: Model) -> float:
        """Of the new posterior, once a candidate is read of a machine."""
        case = with_reading_of(self.case, candidate, machine, self.generator)
        return self.entered(posterior([case])).off.bound_mm["touched-off"]


@dataclass(frozen=True)
class Followed:
    """Bounds of the best proposal and the worst candidate, expected and as they became, mm."""

    best_mm: float
    best_after_mm: float
    worst_mm: float
    worst_after_mm: float


@pytest.fixture(scope="module")
def followed() -> list[Followed]:
    """Twenty sessions, ten each with joint offsets and with kinematics to enter; a machine each."""
    results = []
    for number in range(20):
        trial = Trial.of(number, "offsets" if number % 10 < 5 else "kinematics")
        proposals = trial.planner.proposals
        best, worst = proposals[0], max(proposals, key=lambda proposal: proposal.bound_mm)
        machine = machine_drawn(trial.planner.posterior, trial.generator)
        after = [trial.bound_after_mm(proposal.candidate, machine) for proposal in (best, worst)]
        results.append(Followed(best.bound_mm, after[0], worst.bound_mm, after[1]))
    return results


@LONG
def test_bounds_become_what_was_expected(followed: list[Followed]) -> None:
    best = np.median([step.best_after_mm / step.best_mm for step in followed])
    worst = np.median([step.worst_after_mm / step.worst_mm for step in followed])
    assert 0.85 < best < 1.18
    assert 0.85 < worst < 1.18


@LONG
def test_the_proposal_gains_what_it_promised_over_the_worst_candidate(
    followed: list[Followed],
) -> None:
    """The mean of logarithms, for these are ratios; of forty sessions 0.61 became 0.68."""
    expected = float(np.exp(np.mean([np.log(step.best_mm / step.worst_mm) for step in followed])))
    became = float(
        np.exp(np.mean([np.log(step.best_after_mm / step.worst_after_mm) for step in followed]))
    )
    assert expected < 0.72
    assert 0.8 < became / expected < 1.2


def planner_of(
    case: SessionCase,
    holds: Holds = "offsets",
    frame: Frame = "touched-off",
    pace: Pace | None = None,
) -> Planner:
    result = posterior([case])
    possible = candidates(result, pace) if pace else candidates(result)
    return Planner(result, correction(result, holds, frame), tuple(possible))


@pytest.fixture(scope="module")
def play_or_screw() -> Planner:
    """Play that a short procedure does not tell from a screw."""
    case, _ = session(SHORT, hidden("backlash", "x", 0.03), seed=8, scatter_mm=NOISE_MM)
    return planner_of(case)


@LONG
def test_the_best_a_minute_come_first(play_or_screw: Planner) -> None:
    bound_mm = play_or_screw.bound_mm
    assert bound_mm == play_or_screw.correction.off.bound_mm["touched-off"]
    gains = [proposal.gain_mm_per_minute for proposal in play_or_screw.proposals]
    assert gains == sorted(gains, reverse=True)
    for candidate in play_or_screw.proposals:
        gain = (bound_mm - candidate.bound_mm) / candidate.candidate.minutes
        assert candidate.gain_mm_per_minute == pytest.approx(gain)
    assert gains[0] > 0.0
    assert play_or_screw.more_helps


@LONG
def test_slow_mountings_make_long_set_ups_better() -> None:
    case, _ = session(SHORT, hidden("backlash", "x", 0.03), seed=8, scatter_mm=NOISE_MM)
    slow = planner_of(case, pace=Pace(minutes_per_mounting=60.0, seconds_per_step=1.0))
    quick = planner_of(case, pace=Pace(minutes_per_mounting=0.0, seconds_per_step=60.0))
    steps = [len(proposal.proposals[0].candidate.taken[0]) for proposal in (quick, slow)]
    minutes = [proposal.proposals[0].candidate.minutes for proposal in (quick, slow)]
    assert steps[0] < steps[1]
    assert minutes == [steps[0] / 2, 60.0 + steps[1] / 120]


def test_the_measurement_that_separates_names_decides(play_or_screw: Planner) -> None:
    separation = play_or_screw.separation
    assert separation is not None
    assert separation.names[0] == (("backlash", "x"),)
    assert (("actuator_cyclic", "x"),) in separation.names
    assert separation.apart > DECISIVE
    assert "; it decides between backlash (x), " in separation.words
    result = play_or_screw.posterior
    before = result.places["backlash", "x"]
    case, machine = session(SHORT, *HIDDEN[0], seed=8, scatter_mm=NOISE_MM)
    assert case.observations.value_mm == pytest.approx(
        result.sessions[0].case.observations.value_mm
    )
    generator = np.random.default_rng(1)
    case_after = with_reading_of(case, separation.candidate, machine, generator)
    after = posterior([case_after])
    assert before < 0.7
    assert after.places["backlash", "x"] > 0.9
    assert after.places.get(("actuator_cyclic", "x"), 0.0) < 0.01


def test_where_a_name_is_certain_nothing_is_to_be_separated() -> None:
    case, _ = session(SWEEP, hidden("backlash", "x", 0.05), seed=1)
    planner = planner_of(case)
    assert planner.posterior.places["backlash", "x"] > 0.95
    assert planner.separation is None


@LONG
def test_more_of_the_same_does_not_help_where_offsets_cannot_hold_what_is_known() -> None:
    case, _ = session(TWO_STATION, hidden("backlash", "x", 0.03), seed=8, scatter_mm=NOISE_MM)
    plan = planner_of(case)
    assert not plan.more_helps
    assert plan.outside is None


def test_set_ups_in_turn_lower_the_bound_as_long_as_each_is_worth_it() -> None:
    trial = Trial.of(0, "kinematics")
    reach = trial.planner.reach
    bounds = [trial.planner.bound_mm, *(set_up.bound_mm for set_up in reach.further)]
    assert 1 <= len(reach.further) < 6
    assert reach.is_last
    for before, after in pairwise(bounds):
        assert after < 0.9 * before
    first = reach.further[0]
    proposals = trial.planner.proposals
    alone = [rival for rival in proposals if rival.candidate.levels_mm == first.displacements_mm]
    (proposal,) = [rival for rival in alone if rival.candidate.legs == first.legs]
    assert first.bound_mm == pytest.approx(proposal.bound_mm, rel=1e-6)
    gains = {
        rival.candidate: float(np.log(bounds[0] / rival.bound_mm)) / rival.candidate.minutes
        for rival in proposals
        if rival.candidate.is_way and rival.bound_mm < 0.9 * bounds[0]
    }
    assert gains[proposal.candidate] > 0.99 * max(gains.values())
    assert min(gains.values()) < 0.7 * max(gains.values())
    assert reach.towards(first.bound_mm) == first
    assert reach.towards(bounds[0]) is None
    assert reach.towards(0.0, before_mm=1.05 * bounds[0]) is None


@LONG
@pytest.mark.parametrize(
    ("places", "effect", "frame", "instrument"),
    first_quick(
        [
            ("xy", "axis_squareness", "touched-off", "square"),
            ("yz", "axis_squareness", "touched-off", "plate"),
            ("xy", "axis_offset", "machine", "ball"),
        ],
        several=True,
    ),
)
def test_what_legs_do_not_see_is_shown_by_another_instrument(
    places: str, effect: str, frame: Frame, instrument: str
) -> None:
    case, _ = session(TWO_STATION, hidden(effect, places, 2.0), seed=3, scatter_mm=NOISE_MM)
    planner = planner_of(case, "kinematics", frame)
    outside = planner.outside
    assert outside is not None
    assert outside.instrument == instrument
    assert outside.share > 0.5
    assert outside.bound_mm < 0.5 * planner.bound_mm
    aligned = planner_of(case, "kinematics", "aligned")
    assert aligned.outside is None


def test_weight_on_the_bars_is_seen_by_a_load() -> None:
    case, _ = session(SHORT, hidden("gravity_sag", "y", 0.3), seed=2, scatter_mm=NOISE_MM)
    possible = candidates(posterior([case]))
    loaded = [candidate for candidate in possible if candidate.preparation.load == 2.0]
    assert loaded
    assert all("load the tool to 2 times its weight" in candidate.words for candidate in loaded)
    assert min(candidate.minutes for candidate in loaded) > 5.0


def test_a_shifted_offset_keeps_clear_of_the_joint_limits(play_or_screw: Planner) -> None:
    geometry = Geometry()
    shifted = [
        candidate for candidate in play_or_screw.candidates if any(candidate.preparation.entered_mm)
    ]
    assert shifted
    for way in shifted:
        assert max(way.levels_mm) <= geometry.travel_max_mm - 5.0
        assert min(way.levels_mm) >= geometry.travel_min_mm + 5.0
    assert shifted[0].words.startswith("add ")


def test_an_entered_offset_is_gone_from_the_machine() -> None:
    off = Model(parameters_mm=(1.2, -0.9, 0.6, 0.03, -0.02, 0.01))
    model = MeasurementPreparation((1.2, 0.0, -0.4), 3.0).model(off)
    assert model.parameters_mm == pytest.approx((0.0, -0.9, 1.0, 0.03, -0.02, 0.01))
    assert model.geometry == replace(Geometry(), load=3.0)


def test_a_candidate_is_a_procedure_with_the_readings_that_were_judged(
    play_or_screw: Planner,
) -> None:
    for candidate in play_or_screw.candidates[:: len(play_or_screw.candidates) // 12]:
        procedure = Procedure.model_validate_json(json.dumps(tomllib.loads(candidate.text)))
        steps = [
            (leg_number(s.leg), s.displacement_mm, s.station) for s in procedure.steps(Geometry())
        ]
        judged: list[tuple[int, float, float]] = []
        for part in candidate.taken:
            first = part.axis == part.axis[0]
            columns = (part.leg[first], part.displacement_mm[first], part.station[first])
            judged += zip(*(column.tolist() for column in columns), strict=True)
        assert steps == judged


def test_a_candidate_in_words_and_as_a_procedure() -> None:
    path = (0.0, -20.0, 60.0)
    single = FurtherMeasurement((), 5.0, ("y",), 0.3, path)
    assert single.words == "leg Y, 30% from the tool end: Zero, -20, +60 mm"
    assert single.is_way
    loaded = MeasurementPreparation((0.0, 5.0, 0.0), load=2.0)
    several = FurtherMeasurement((), 5.0, ("x", "z"), 0.7, (60.0, -20.0), 3, loaded)
    assert several.words == (
        "add +5 mm to the entered joint offset of Y and load the tool to 2 times its weight and "
        "note load = 2 in the machine file; then legs X, Z, 70% from the tool end: "
        "Zero, +60, -20 mm, 3 times"
    )
    assert not several.is_way
    assert [tomllib.loads(candidate.text)["levels"] for candidate in (single, several)] == [
        ["zero", -20.0, 60.0],
        ["zero", 60.0, -20.0],
    ]
    assert tomllib.loads(several.text)["description"] == f"First {loaded.words}."


def test_a_procedure_of_the_program_is_judged_beside_set_ups(play_or_screw: Planner) -> None:
    sweep = tuple(SWEEP.take(SWEEP.leg == leg) for leg in range(3))
    result = play_or_screw.posterior
    (candidate,) = [c for c in candidates(result, procedures={"sweep": sweep}) if c.procedure]
    assert candidate.words == "procedure sweep"
    assert candidate.text == "sweep"
    steps = sum(len(part) for part in sweep) / 2
    assert candidate.minutes == pytest.approx(3 * 2.0 + steps / 3.0)
    (proposal,) = Planner(result, play_or_screw.correction, (candidate,)).proposals
    best = min(play_or_screw.proposals, key=lambda proposal: proposal.bound_mm)
    assert proposal.bound_mm == pytest.approx(best.bound_mm, rel=0.05)


@LONG
def test_a_session_without_a_known_noise_has_a_plan() -> None:
    case, _ = session(SHORT, seed=3, scatter_mm=NOISE_MM)
    once = case.observations.take(np.flatnonzero(case.observations.cycle == 1))
    plan = planner_of(replace(case, observations=once))
    bounds = [proposal.bound_mm for proposal in plan.proposals]
    assert 0.1 * plan.bound_mm < min(bounds) < plan.bound_mm < np.inf
