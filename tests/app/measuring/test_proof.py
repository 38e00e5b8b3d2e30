"""A machine that nobody proved moves its carriages a little, one by one, before anything longer."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from math import dist
from pathlib import Path

import pytest

from app.measuring.moving import MoveProposal, limits_of
from app.measuring.opening import PlanCheck, start_session
from app.measuring.plan import Plan
from app.measuring.proof import FEED_MM_MIN, Proof, proved_path
from app.measuring.session import GuidedSession
from app.measuring.unattended import measure_all
from calib.errors import MotionError
from drivers.motion.states import State
from protocols.carriages import changes, moved_alone
from protocols.machine import Instrument, load_machine
from protocols.procedure import load_procedure
from protocols.record import read_record
from protocols.session import Noted
from tests.app.measuring.moving_machine import (
    FAST,
    SHORT,
    Bench,
    carriages,
    following,
    linuxcnc,
    remember_proved,
    taken,
    wrong,
)
from tests.conftest import first_quick, needs_links
from tests.drivers.motion.bench import BUSY
from tests.drivers.motion.twins import TWINS, MotionTrouble, MotionTwin

JOINT = FAST.model_copy(update={"mdi": "joint"})
START = carriages((3.0, -2.0, 1.0))
PLACES = re.compile(r"X([-.\d]+) ?Y([-.\d]+) ?Z([-.\d]+)")
LEAST_MM, MOST_MM = 4.9, 5.01

Carriages = Callable[[list[float]], list[float]]


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("app.measuring.opening.STRICT", BUSY)
    monkeypatch.setattr("app.measuring.gauges.LOST_S", 20.0)
    monkeypatch.setattr("app.measuring.moving.FEED_MM_MIN", 3000.0)


def times(*factors: float) -> Carriages:
    """Each carriage goes so many times as far from the start."""
    return lambda now: [s + f * (n - s) for s, f, n in zip(START, factors, now, strict=True)]


def exchanged(*order: int) -> Carriages:
    """Carriage k follows the joint of this number."""
    return lambda now: [START[k] + now[j] - START[j] for k, j in enumerate(order)]


@contextmanager
def unproved(
    folder: Path,
    wired: Carriages = list,
    *,
    controller: str = "linuxcnc",
) -> Iterator[tuple[Plan, Bench, MotionTwin]]:
    """A machine that was never proved, behind its controller."""
    make = TWINS["grbl"] if controller == "grbl" else linuxcnc
    machine = JOINT if controller == "grbl" else FAST
    with following(make, machine.mdi) as (bench, twin, ports):
        bench.wired = wired
        instruments = tuple(Instrument(profile="mitutoyo-01a", port=port) for port in ports)
        path = folder / "a.jsonl"
        plan = Plan(path, machine, SHORT, instruments, window_s=0.1, motion=twin.endpoint)
        yield plan, bench, twin


class Operator:
    """Sets up what is to be, agrees, and sees what a carriage does while it moves."""

    def __init__(self, bench: Bench, *, missing: str = "nothing", to_the_end: bool = True) -> None:
        self.proposals: list[MoveProposal] = []
        self.questions: list[str] = []
        self._bench, self._missing, self._to_the_end = bench, missing, to_the_end

    def agree(self, proposal: MoveProposal) -> bool:
        self.proposals.append(proposal)
        assert not self._bench.axes.moving
        agrees = self._to_the_end or proposal.proof is not None
        return agrees and self._bench.agree(proposal)

    def saw(self, question: str) -> bool:
        self.questions.append(question)
        return self._missing not in question


def measured(plan: Plan, operator: Operator) -> GuidedSession:
    with start_session(plan) as guided:
        assert guided.mover is not None
        guided.mover.line.homing_confirmed = True
        measure_all(guided, operator.agree, lambda _: None, operator.saw)
    return guided


def sent_mm(twin: MotionTwin, start: tuple[float, float, float]) -> list[float]:
    """How long each move is that was sent."""
    lengths, before = [], start
    for line in twin.moves:
        match = PLACES.search(line)
        assert match, line
        to = tuple(map(float, match.groups()))
        lengths.append(dist(before, to))
        before = (to[0], to[1], to[2])
    return lengths


def notes(path: Path) -> str:
    return "\n".join(event.text for event in read_record(path).events if isinstance(event, Noted))


@pytest.mark.parametrize("controller", first_quick(TWINS))
def test_each_carriage_is_proved_before_anything_longer(controller: str, tmp_path: Path) -> None:
    with unproved(tmp_path, controller=controller) as (plan, bench, twin):
        operator, start = Operator(bench), bench.axes.at_mm
        measured(plan, operator)
        lengths = sent_mm(twin, start)
    assert not wrong(taken(plan.path), bench)
    assert all(LEAST_MM <= length <= MOST_MM for length in lengths[:6])
    proofs = [proposal for proposal in operator.proposals if proposal.proof]
    assert [proposal.proof.carriage for proposal in proofs if proposal.proof] == list("xyz")
    assert operator.proposals[:3] == proofs
    assert [proposal.by_hand for proposal in proofs] == [True, False, False]
    assert operator.proposals[3].to_zero
    assert [proposal.clears for proposal in operator.proposals].index(True) == 3
    assert [proposal.clears for proposal in operator.proposals].count(True) == 1
    assert len(operator.questions) == 1  # of carriage x, which stands along the leg
    assert "Did carriage X alone move 5 mm outward" in operator.questions[0]
    words = notes(plan.path)
    assert "carriage Y 5 mm outward" in words
    assert "direction, order and scale of every carriage" in words


def test_ports_that_were_exchanged_before_it_are_not_read_as_carriages(tmp_path: Path) -> None:
    with unproved(tmp_path) as (plan, bench, _):
        along_y, along_z = plan.instruments
        short = along_z.model_copy(update={"travel_mm": 2.0})
        check = PlanCheck(replace(plan, instruments=(short, along_y)))
        indicators = check.open()
        check.find_spindles()
        assert indicators is not None
        operator = Operator(bench, to_the_end=False)
        with (
            check.begin(check.exchange(indicators)) as guided,
            pytest.raises(MotionError, match="consent: found not given"),
        ):
            measure_all(guided, operator.agree, lambda _: None, operator.saw)
    assert "direction, order and scale of every carriage" in notes(plan.path)
    ways_mm = [proposal.proof.way_mm for proposal in operator.proposals if proposal.proof]
    assert ways_mm == [5.0, 5.0, 1.0]


@pytest.mark.parametrize(
    ("wired", "words"),
    first_quick(
        [
            (
                exchanged(0, 2, 1),
                "Sent carriage Y 5 mm outward, .*carriage Z move[sd] in its place",
            ),
            (
                exchanged(1, 0, 2),
                "Sent carriage X 5 mm outward, .*carriage Y move[sd] in its place",
            ),
            (times(1.0, 1 / 25.4, 1.0), "Sent carriage Y .*(0.0. times as far|or none did)"),
            (times(1.0, 2.0, 2.0), "Sent carriage Y .*it goes too far"),
            (times(1.0, 1.0, 0.5), "Sent carriage Z .*0.5[01] times as far"),
            (times(1.0, 1.1, 1.0), "Sent carriage Y .*(it goes too far|1.1. times as far)"),
            (times(1.0, 0.9, 1.0), "Sent carriage Y .*0.9. times as far"),
        ],
        several=True,
    ),
)
def test_a_controller_that_moves_another_carriage_or_another_length_moves_nothing_longer(
    wired: Carriages, words: str, tmp_path: Path
) -> None:
    with unproved(tmp_path, wired) as (plan, bench, twin):
        start = bench.axes.at_mm
        with pytest.raises(MotionError, match=words) as refusal:
            measured(plan, Operator(bench))
        lengths = sent_mm(twin, start)
    assert "at the controller" in str(refusal.value)
    assert all(length <= MOST_MM for length in lengths)
    assert not taken(plan.path)
    assert "proof failed" in notes(plan.path)
    assert not proved_path().exists()


def test_a_machine_that_takes_mm_for_inches_is_stopped_on_its_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.measuring.moving.FEED_MM_MIN", FEED_MM_MIN)
    with unproved(tmp_path, times(1.0, 25.4, 25.4)) as (plan, bench, twin):
        start = bench.axes.at_mm
        with pytest.raises(MotionError, match=r"Sent carriage Y .*an inch for a mm is 25.4 times"):
            measured(plan, Operator(bench))
        went_mm = bench.carriages_mm[1] - START[1]
        assert 3.0 < went_mm < 40.0  # of 127
        assert all(length <= MOST_MM for length in sent_mm(twin, start))


@pytest.mark.parametrize("factors", first_quick([(-1.0, 1.0, 1.0), (1.0, 1.0, -1.0)]))
def test_a_wrong_direction_is_seen_by_the_operator(
    factors: tuple[float, float, float], tmp_path: Path
) -> None:
    """An indicator tells it, too, if it is not held so that it counts against: he is asked."""
    with unproved(tmp_path, times(*factors)) as (plan, bench, twin):
        reversed_one = "XYZ"[factors.index(-1.0)]
        operator, start = Operator(bench, missing=f"carriage {reversed_one}"), bench.axes.at_mm
        with pytest.raises(MotionError, match=r"did not see carriage .* Correct the direction"):
            measured(plan, operator)
        assert all(length <= MOST_MM for length in sent_mm(twin, start))


def test_an_indicator_that_counts_against_is_noted_once_the_operator_saw_the_carriage(
    tmp_path: Path,
) -> None:
    with unproved(tmp_path) as (plan, bench, _):
        bench.signs = (-1.0, 1.0)
        operator = Operator(bench, to_the_end=False)
        with pytest.raises(MotionError, match="consent"):
            measured(plan, operator)
        assert [("carriage X" in q, "carriage Y" in q) for q in operator.questions] == [
            (True, False),
            (False, True),
        ]
    assert "moved the other way" in notes(plan.path)
    assert proved_path().exists()


def test_a_stop_in_the_middle_proves_nothing_and_the_carriage_begins_anew(tmp_path: Path) -> None:
    with unproved(tmp_path) as (plan, bench, twin), start_session(plan) as guided:
        mover, operator = guided.mover, Operator(bench)
        assert mover is not None

        def stop_on_the_way() -> None:
            while not bench.axes.moving:
                time.sleep(0.001)
            mover.stop("the operator", by_operator=True)

        threading.Thread(target=stop_on_the_way).start()
        start = bench.axes.at_mm
        with pytest.raises(MotionError, match="the operator"):
            measure_all(guided, operator.agree, lambda _: None, operator.saw)
        assert len(twin.moves) == 1
        assert mover.state is State.STOPPED
        guided.note(*mover.watch())
        proposal = mover.proposal
        assert proposal is not None
        assert proposal.proof is not None
        assert proposal.proof.carriage == "x"
        assert dist(start, bench.axes.at_mm) < MOST_MM
        while (proof := mover.unproved) is not None:
            mover.line.alive()
            guided.note(*mover.watch())
            if proof.question:
                guided.note(*mover.answer_proof(yes=True))
            if proof is mover.unproved:
                mover.consent()
            time.sleep(0.01)
        assert len(twin.moves) == 7
        assert all(length <= MOST_MM for length in sent_mm(twin, start)[1:])


def test_nothing_moves_without_the_indicators_at_rest(tmp_path: Path) -> None:
    with unproved(tmp_path) as (plan, _, twin), start_session(plan) as guided:
        guided.go()
        assert guided.mover is not None
        assert guided.mover.proposal is not None
        assert not guided.mover.consent()  # no window of rest is over yet
        assert not twin.moves


def test_a_machine_outside_its_limits_is_told_to_be_jogged(tmp_path: Path) -> None:
    with unproved(tmp_path) as (plan, bench, twin):
        bench.axes.go((90.0, 0.0, 0.0), 1e9)
        with pytest.raises(MotionError, match="Jog it there"):
            measured(plan, Operator(bench))
        assert not twin.moves


def test_a_proved_machine_is_remembered_until_its_file_or_controller_is_another(
    tmp_path: Path,
) -> None:
    with unproved(tmp_path) as (plan, _, twin):
        remember_proved(plan)

        def needed(changed: Plan) -> bool:
            with start_session(replace(changed, path=tmp_path / f"{time.time_ns()}")) as guided:
                assert guided.mover is not None
                return guided.mover.unproved is not None

        assert not needed(plan)
        assert needed(replace(plan, prove=True))
        longer = plan.machine.model_copy(update={"leg_length_mm": 311.0})
        assert needed(replace(plan, machine=longer))
        assert needed(replace(plan, machine=plan.machine.model_copy(update={"name": "other"})))
        twin.befall(MotionTrouble.INCH)  # it answers in inches now
        assert needed(plan)
        twin.mend()
        assert not needed(plan)
        entered = plan.machine.model_copy(update={"entered_offsets_mm": (0.1, 0.2, 0.3)})
        assert not needed(replace(plan, machine=entered))


@needs_links
def test_what_is_remembered_is_written_through_no_link_and_over_no_broken_file(
    tmp_path: Path,
) -> None:
    with unproved(tmp_path) as (plan, _, _):
        target, path = tmp_path / "other.txt", proved_path()
        target.write_text("{}")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.symlink_to(target)
        remember_proved(plan)
        assert target.read_text() == "{}"
        path.unlink()
        path.write_text("broken")
        remember_proved(plan)
        assert path.read_text() == "broken"


def test_an_indicator_of_little_travel_asks_for_a_shorter_move() -> None:
    step = SHORT.steps(FAST.geometry())[0]
    short = tuple(Instrument(profile="mitutoyo-01a", travel_mm=4.0) for _ in range(2))
    proof = Proof(FAST, limits_of(FAST), short, "linuxcnc:x")
    assert proof.next_move(step, (0.0, 0.0, 0.0)).way_mm == 5.0  # along the leg
    proof.begin(proof.next_move(step, (0.0, 0.0, 0.0)), (0.0, 0.0))
    proof.back((0.0, 0.0))
    assert proof.next_move(step, (0.0, 0.0, 0.0)).way_mm == 2.0


def test_at_the_end_of_its_travel_a_carriage_goes_inward() -> None:
    step = SHORT.steps(FAST.geometry())[0]
    proof = Proof(FAST, limits_of(FAST), (Instrument(profile="mitutoyo-01a"),) * 2, "linuxcnc:x")
    assert proof.next_move(step, (58.0, 0.0, 0.0)).way_mm == -5.0


def test_a_delta_is_proved_by_the_operators_eye() -> None:
    """Its indicator against a plate tells little: what it tells must fit, and he is asked."""
    machine = load_machine("linear-delta")
    procedure = load_procedure(machine.usual_procedure, machine.geometry())
    step = procedure.steps(machine.geometry())[0]
    for carriage in "xyz":
        to = moved_alone((0.0, 0.0, 0.0), carriage, 5.0, machine)
        assert to is not None
        (due,) = changes(step, (0.0, 0.0, 0.0), to, machine)
        assert due.nominal_mm == pytest.approx(1.76, abs=0.01)
        assert due.within_mm > 0.1 * due.nominal_mm
