"""What is asked while measuring and of a Hexa Slide, of a person who answers from a list."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from pathlib import Path
from typing import TypeVar

import pytest

from app.dialogue.corrections import CorrectionDialogue, other_port
from app.dialogue.hexaslide import MOST_POSTURES, asked_count, asked_request
from app.measuring import indicators
from app.measuring.session import GuidedSession
from app.measuring.unattended import take_simulated
from app.planning.hexaslide import Request
from calib.errors import IndicatorError, UsageError
from calib.hexaslide.procedures import ProcedureKind
from tests.app.dialogue.scripted import Scripted
from tests.app.measuring.test_plane_session import session

Answer = TypeVar("Answer")


def asked(question: Coroutine[object, object, Answer]) -> Answer:
    return asyncio.run(question)


def measure(guided: GuidedSession) -> None:
    """Every step; the record stays open."""
    while guided.step() is not None:
        guided.go()
        take_simulated(guided)


def test_a_step_is_measured_again_with_a_reason_or_not_at_all(tmp_path: Path) -> None:
    with session(tmp_path / "s.jsonl") as (guided, _):
        measure(guided)
        person = Scripted(None, "step   2", "", "step   2", "bumped")
        correcting = CorrectionDialogue(person, guided)
        assert not asked(correcting.earlier())
        assert person.lines == []
        assert not asked(correcting.earlier())
        assert person.lines == ["Nothing changes, the session is done."]
        assert not guided.session.superseded
        assert asked(correcting.earlier())
        assert set(guided.session.superseded.values()) == {"bumped"}
        assert person.lines[-1] == "Step 2 is measured again: bumped"
        step = guided.step()
        assert step is not None
        assert step.number == 2


def test_readings_that_were_replaced_are_used_again(tmp_path: Path) -> None:
    with session(tmp_path / "s.jsonl") as (guided, _):
        measure(guided)
        last = guided.last_step
        again = f"step {last:>3}"
        person = Scripted(again, "No", again, "Yes")
        correcting = CorrectionDialogue(person, guided)
        assert asked(correcting.undo())
        assert "is next again" in person.lines[-1]
        assert not asked(correcting.earlier())
        assert asked(correcting.earlier())
        assert guided.step() is None
        assert person.lines[-1] == f"The readings of step {last} are used again."


def test_the_rest_of_a_leg_is_skipped_and_a_stand_set_up_anew(tmp_path: Path) -> None:
    with session(tmp_path / "s.jsonl") as (guided, _):
        person = Scripted("No", "Yes", None, "The rest of leg X", "no room")
        correcting = CorrectionDialogue(person, guided)
        assert not asked(correcting.remount())
        assert asked(correcting.remount())
        assert not asked(correcting.skip())
        assert asked(correcting.skip())
        assert guided.step() is None
        assert person.lines[-1].startswith("Skipped: no room. {measure.earlier}")


def test_a_port_is_chosen_of_those_that_are_free_or_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [("/dev/one", "an adapter"), ("/dev/two", "another")]
    monkeypatch.setattr(indicators, "serial_ports", lambda: ports)
    monkeypatch.setattr(indicators, "adapters", lambda: {"/dev/two": "A7"})
    typed = "A port that is not listed"
    person = Scripted("/dev/two", typed, "socket://gauges:4001", typed, "", typed, "spy://x", None)
    assert asked(other_port(person, "indicator 1", "A7", ["/dev/one"])) == "/dev/two"
    same = "/dev/two  another, the same adapter, no. A7"
    assert person.offered == [[same, f"{typed}: type it"]]
    ports_in_use = [port for port, _ in ports]
    assert asked(other_port(person, "indicator 1", "A7", ports_in_use)) == "socket://gauges:4001"
    assert "No other serial port is here" in person.questions[1]
    assert person.offered[1] == [f"{typed}: type it"]
    assert asked(other_port(person, "indicator 1", "A7", ports_in_use)) is None
    with pytest.raises(IndicatorError, match="Allowed: a serial port, socket://HOST:PORT"):
        asked(other_port(person, "indicator 1", "A7", ports_in_use))
    assert asked(other_port(person, "indicator 1", "A7", ports_in_use)) is None


def test_what_is_asked_of_a_hexa_slide() -> None:
    request = Request(ProcedureKind.POSE_INVERSE)
    person = Scripted("position", "x, y", "", None, "12", "2", "")
    other = asked(asked_request(person, "procedure", request))
    assert other == Request(ProcedureKind.POSITION)
    other = asked(asked_request(person, "measured", request))
    assert other == Request(ProcedureKind.POSE_FORWARD, measured=("x", "y"))
    assert asked(asked_request(person, "machine", request)) is None
    assert asked(asked_request(person, "machine", request)) is None
    assert asked(asked_count(person, 9, 9)) == 12
    with pytest.raises(UsageError, match=f"found '2'. Allowed: 9 to {MOST_POSTURES}"):
        asked(asked_count(person, 9, 9))
    assert asked(asked_count(person, 9, 9)) is None
