"""``run --motion``: what is shown, what is asked, and what is refused before anything moves."""

from __future__ import annotations

import _thread
import io
import os
import re
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from app.commands import measuring
from app.measuring.plan import Plan
from app.measuring.simulated import simulated_session
from app.report.text.motion import HOMED_QUESTION
from calib.errors import MotionError, UsageError
from calib.tripod.pipeline import Model
from drivers.motion.guard import DETACHED
from drivers.motion.line import MotionLine
from protocols.journal import write_whole
from protocols.machine import Instrument, MotionLimits
from protocols.machine import Machine as MachineFile
from protocols.procedure import load_procedure
from protocols.record import read_record
from tests.app.cli import glidecal, refused, run_here
from tests.app.measuring.moving_machine import (
    FAST,
    SHORT,
    following,
    remember_proved,
    taken,
    wrong,
)
from tests.conftest import LONG
from tests.drivers.motion.bench import BUSY, PATIENCE_S, comes_true
from tests.drivers.motion.twins import TWINS, GrblTwin, MotionTrouble, MotionTwin

TWO = ("--indicator", "mitutoyo-01a:/dev/none0@xy", "--indicator", "mitutoyo-01a:/dev/none1@yzx")


class Terminal(io.StringIO):
    """Somebody who answers."""

    def isatty(self) -> bool:
        return True


def plan_of(folder: Path, motion: str, ports: tuple[str, ...]) -> Plan:
    instruments = tuple(Instrument(profile="mitutoyo-01a", port=port) for port in ports)
    return Plan(folder / "a.jsonl", FAST, SHORT, instruments, window_s=0.1, motion=motion)


def test_a_dry_run_shows_every_posture_and_asks_nobody() -> None:
    usual = ("--protocol", "zero-max-min")
    run = glidecal("run", *TWO, *usual, "--motion", "linuxcnc:nowhere:5007", "--dry-run")
    assert run.status == 0, run.err
    text = " ".join(run.out.split())
    assert text.count("G53 G1 X") == 30
    assert "30 steps at 1500 mm/min, longest move 160.0 mm" in text
    assert "Never outside X-100.000 Y-100.000 Z-100.000 … X60.000 Y60.000 Z60.000" in text


def test_without_a_procedure_it_takes_one_that_nobody_would_type() -> None:
    run = glidecal("run", *TWO, "--motion", "linuxcnc:nowhere:5007", "--dry-run")
    assert run.status == 0, run.err
    text = " ".join(run.out.split())
    assert "Procedure two-station: the usual one where a machine moves itself" in text
    assert text.count("G53 G1 X") == 138
    by_hand = glidecal("run", *TWO, "--dry-run")
    assert by_hand.out.count("G53 G0 X") == 30


def test_what_the_record_tells_is_refused_beside_continue(tmp_path: Path) -> None:
    for words in (("--dry-run",), ("--seed", "1"), ("--note", "n"), ("-o", "b.jsonl")):
        message = refused(2, "run", "--continue", tmp_path, *words)
        assert f"{words[0].replace('-o', '--output')}: found beside --continue" in message


def test_a_seed_of_the_simulation_is_refused_beside_real_indicators(tmp_path: Path) -> None:
    words = ("run", "--indicator", "sylvac:COM7", "--seed", "4", "-o", tmp_path / "a.jsonl")
    message = refused(2, *words)
    assert message.startswith(
        "glidecal: --seed: found beside real indicators. Allowed: --seed with"
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ((*TWO, "--motion", "klipper:x"), 2, "--motion: found 'klipper:x'. Allowed: linuxcnc:"),
        ((*TWO, "--motion", "klipper:x", "--dry-run"), 2, "--motion: found 'klipper:x'"),
        ((*TWO, "--motion", "", "--headless"), 2, "--motion: found ''. Allowed: linuxcnc:HOST"),
        ((*TWO, "--motion", ""), 2, "--motion: found ''. Allowed: linuxcnc:HOST:PORT or grbl:"),
        (TWO, 2, "Allowed: a terminal, or --headless with --simulated or --motion"),
        ((*TWO, "--motion", "linuxcnc:localhost:1"), 2, "no terminal"),
        ((*TWO, "--motion", "linuxcnc:localhost:1", "--headless"), 2, "no terminal"),
        (("--simulated", "--motion", "linuxcnc:localhost:1"), 2, "simulated machine"),
    ],
)
def test_without_a_terminal_nothing_moves(
    words: tuple[str, ...], status: int, message: str, tmp_path: Path
) -> None:
    run = glidecal("run", *words, "-o", tmp_path / "a.jsonl")
    assert run.status == status
    assert message in run.err
    assert not list(tmp_path.iterdir())


def test_the_operator_says_no(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("n\n"))
    with following() as (_, twin, ports):
        with pytest.raises(typer.Exit) as exit_info:
            measuring.measure(plan_of(tmp_path, twin.endpoint, ports), headless=True)
        assert exit_info.value.exit_code == 130
        assert not twin.moves


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_what_is_typed_ahead_answers_no_question(monkeypatch: pytest.MonkeyPatch) -> None:
    """A double "y" at the first question would say that the machine was homed."""
    operator, terminal = os.openpty()
    ask = typer.confirm

    def shown(question: str, *, err: bool) -> bool:
        os.write(operator, b"n\n")
        return ask(question, err=err)

    monkeypatch.setattr("typer.confirm", shown)
    with os.fdopen(terminal, encoding="utf-8") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        os.write(operator, b"y\n")
        assert not measuring.confirm(HOMED_QUESTION)
    os.close(operator)


def test_a_machine_that_is_not_homed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("y\n"))
    with following() as (_, twin, ports):
        twin.befall(MotionTrouble.NOT_HOMED)
        with pytest.raises(MotionError, match="home it"):
            measuring.measure(plan_of(tmp_path, twin.endpoint, ports), headless=True)
        with pytest.raises(UsageError, match="linuxcnc:HOST:PORT or grbl:PORT"):
            measuring.measure(plan_of(tmp_path, "klipper:x", ports), headless=True)
        assert not list(tmp_path.iterdir())


@LONG
def test_a_session_in_a_plain_terminal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All of `glidecal run`; whoever answers a question about a set-up has set it up."""
    machine, procedure = tmp_path / "machine.toml", tmp_path / "short.toml"
    machine.write_text(
        'schema = "glidecal.machine/1"\nfastest_feed_mm_min = 60000.0\n'
        "[motion]\nfeed_mm_min = 30000.0\n"
    )
    procedure.write_text(
        'schema = "glidecal.procedure/1"\nname = "short"\ntitle = "Short"\nlegs = ["x"]\n'
        'cycles = 1\nwindow_s = 0.1\nlevels = ["zero", "max"]\n'
    )
    path = tmp_path / "a.jsonl"
    monkeypatch.setattr("app.measuring.opening.STRICT", BUSY)
    with following() as (bench, twin, ports):
        monkeypatch.setattr("sys.stdin", Terminal("y\ny\ny\n"))  # all of it, to Zero, a leg
        named = [
            word
            for port, axes in zip(ports, ("yzx", "zxy"), strict=True)
            for word in ("--indicator", f"mitutoyo-01a:{port}@{axes}")
        ]
        remember_proved(plan_of(tmp_path, twin.endpoint, ports))
        files = ("--protocol", f"{procedure}", "--machine", f"{machine}", "-o", f"{path}")
        status, _, text = run_here("run", *files, *named, "--headless", "--motion", twin.endpoint)
    assert status == 0
    assert "Guards closed" in text
    assert "Set up at leg X, station 0.5, along Y and Z" in text
    assert read_record(path).end == "closed"
    assert len(taken(path)) == 6
    assert not wrong(taken(path), bench)


@pytest.mark.parametrize(
    ("troubles", "answers", "questions"),
    [
        ((), "y\ny\nn\n", ("Was it homed since it was switched on",)),
        ((), "y\nn\ny\nn\n", ("Was it homed since it was switched on", "Home it now")),
        ((MotionTrouble.NOT_HOMED,), "y\ny\nn\n", ("Home it now",)),
    ],
)
def test_a_board_is_homed_with_a_word_for_it_typed_in_the_terminal(
    troubles: tuple[MotionTrouble, ...],
    answers: str,
    questions: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(answers))
    received: list[str] = []
    answer = GrblTwin.answer

    def noted(twin: GrblTwin, line: str) -> str:
        received.append(line)
        return answer(twin, line)

    monkeypatch.setattr(GrblTwin, "answer", noted)
    monkeypatch.setattr("app.measuring.opening.STRICT", BUSY)
    in_joints = FAST.model_copy(update={"mdi": "joint"})
    with following(TWINS["grbl"], "joint") as (_, twin, ports):
        for trouble in troubles:
            twin.befall(trouble)
        plan = replace(plan_of(tmp_path, twin.endpoint, ports), machine=in_joints)
        with pytest.raises(MotionError, match="consent: found not given"):
            measuring.measure(plan, headless=True)
    assert ("$H" in received) is ("Home it now" in questions)
    lines = capsys.readouterr().err.replace("[y/N]:", "\n").splitlines()
    assert not [line for line in lines if len(line) > 80]
    text = " ".join(" ".join(lines).split())
    for question in ("Was it homed since it was switched on", "Home it now"):
        assert (question in text) is (question in questions)


SLOW = MachineFile(motion=MotionLimits(feed_mm_min=30.0))
"""On its way to Zero for seven seconds: on a busy machine a stop may take one of them."""


@contextmanager
def on_its_way(
    folder: Path, monkeypatch: pytest.MonkeyPatch, then: Callable[[MotionTwin], None]
) -> Iterator[tuple[Plan, MotionTwin]]:
    """A plan whose machine is proved; ``then`` is called once, in a thread, when it moves."""
    monkeypatch.setattr("sys.stdin", Terminal("y\n" * 9))
    monkeypatch.setattr("app.measuring.opening.STRICT", BUSY)
    with following() as (_, twin, ports):
        plan = replace(plan_of(folder, twin.endpoint, ports), machine=SLOW)
        remember_proved(plan)

        def befall() -> None:
            if comes_true(lambda: twin.axes.moving, within_s=60.0):
                then(twin)

        thread = threading.Thread(target=befall)
        thread.start()
        yield plan, twin
        thread.join()
        twin.mend()
        assert comes_true(lambda: all(guard.poll() is not None for guard in DETACHED))


def test_ctrl_c_stops_it_and_says_how_to_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("drivers.motion.line.STOP_S", PATIENCE_S)
    with on_its_way(tmp_path, monkeypatch, lambda _: _thread.interrupt_main()) as (plan, twin):
        with pytest.raises(KeyboardInterrupt):
            measuring.measure(plan, headless=True)
        assert not twin.axes.moving
        assert twin.axes.at_mm != (0.0, 0.0, 0.0)
    message = " ".join(capsys.readouterr().err.split())
    assert "Session paused after 0 of" in message
    assert f"glidecal run --headless --continue {plan.path} --motion {twin.endpoint}" in message
    assert "NOT STOPPED" not in message


def test_a_machine_that_does_not_stop_is_said_before_anything_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Letting go of a controller that does not answer takes seconds: no time to lose then."""
    messages: list[str] = []
    before: list[str] = []
    close = MotionLine.close

    def noted(line: MotionLine) -> None:
        before.extend(messages)
        close(line)

    def silent(twin: MotionTwin) -> None:
        twin.befall(MotionTrouble.SILENCE)

    with on_its_way(tmp_path, monkeypatch, silent) as (plan, _):
        monkeypatch.setattr(measuring, "say", messages.append)
        monkeypatch.setattr(MotionLine, "close", noted)
        with pytest.raises(MotionError):
            measuring.measure(plan, headless=True)
        assert any(words.startswith("NOT STOPPED. Use the emergency stop.") for words in before)


TRUTH = Model(FAST.geometry(), (0.8, -1.3, 0.45, 0.02, -0.01, 0.03))


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> list[Plan]:
    """What was measured since, on a machine without ports."""
    plans: list[Plan] = []

    def measure(plan: Plan, *, headless: bool) -> None:
        assert headless
        plans.append(plan)
        session = simulated_session(
            plan.procedure,
            plan.machine,
            TRUTH,
            seed=len(plans),
            scatter_mm=0.002,
            resolution_mm=0.001,
        )
        write_whole(plan.path, session.opened, [*session.readings])

    monkeypatch.setattr(measuring, "measure", measure)
    return plans


@LONG
def test_set_up_after_set_up_until_the_bound_is_reached(
    tmp_path: Path, measured: list[Plan], capsys: pytest.CaptureFixture[str]
) -> None:
    usual = load_procedure("zero-max-min", FAST.geometry())
    plan = replace(plan_of(tmp_path, "linuxcnc:nowhere:1", ("a", "b")), procedure=usual)
    measuring.measured_until(plan, None, headless=True)
    message = " ".join(capsys.readouterr().err.split())
    assert "postures in" in message
    assert len(measured) == 1
    assert f"glidecal run --headless --continue {plan.path}" in message
    measuring.measured_until(plan, 0.009, headless=True, is_complete=True)
    message = " ".join(capsys.readouterr().err.split())
    assert "That is within the 0.009 mm asked for" in message
    assert 2 <= len(measured) <= 3
    bounds = [float(mm) for mm in re.findall(r"at most ([\d.]+) mm r\.m\.s\.", message)]
    assert bounds[0] > 0.009 >= bounds[-1]
    assert [plan.path.name for plan in measured[:2]] == ["a.jsonl", "a_further.jsonl"]
    assert (measured[1].procedure.name, measured[1].procedure.cycles) == ("further", 1)


@LONG
def test_where_more_does_not_help_it_stops(
    tmp_path: Path, measured: list[Plan], capsys: pytest.CaptureFixture[str]
) -> None:
    sweep = load_procedure("two-station", FAST.geometry())
    plan = replace(plan_of(tmp_path, "linuxcnc:nowhere:1", ("a", "b")), procedure=sweep)
    measuring.measured_until(plan, 0.0, headless=True)
    assert "More set-ups on legs would not help" in " ".join(capsys.readouterr().err.split())
    assert len(measured) <= 4


def test_until_is_for_a_machine_that_moves_itself_and_legs(
    tmp_path: Path, measured: list[Plan]
) -> None:
    plan = plan_of(tmp_path, "linuxcnc:nowhere:1", ("a", "b"))
    for wrong_plan, headless in ((plan, False), (replace(plan, motion=None), True)):
        with pytest.raises(UsageError, match="--headless"):
            measuring.measured_until(wrong_plan, 0.1, headless=headless)
    assert not measured
