"""Which sessions a choice at home is carried out with, without a terminal."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, TypeVar

import pytest

from app.dialogue.sessions import Errand, SessionChoice, plan_to_go_on
from app.measuring.recorded import named_sessions, recent_sessions
from app.report.text import home as texts
from calib.errors import RecordError, UsageError
from protocols.machine import Instrument
from tests.app.dialogue.scripted import Scripted
from tests.app.posture_sessions import posture_session
from tests.recorded import opened, write

Answer = TypeVar("Answer")
BEFORE, AFTER = "before.jsonl", "after.jsonl"


@pytest.fixture
def folder(tmp_path: Path, samples: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    shutil.copy(samples / "experiment_2_twelve.jsonl", tmp_path / BEFORE)
    shutil.copy(samples / "experiment_3_twelve.jsonl", tmp_path / AFTER)
    shutil.copy(samples / "damaged.jsonl", tmp_path / "damaged.jsonl")
    monkeypatch.chdir(tmp_path)
    return tmp_path


async def errand(person: Scripted, what: str, path: str = "") -> Errand | None:
    errand = await SessionChoice(person, recent_sessions(Path())).errand(what, path)
    assert not person.answers, "every answer was asked for"
    return errand


async def test_a_session_is_asked_for_until_it_can_be_read(folder: Path) -> None:
    person = Scripted("damaged", BEFORE)
    assert await errand(person, "result") == ("result", Path(BEFORE), None)
    assert person.questions[0] == texts.WHICH["result"]
    assert "session damaged.jsonl, line" in person.questions[1]
    person = Scripted(texts.ELSEWHERE, "none.jsonl", texts.ELSEWHERE, "", None)
    assert await errand(person, "replay") is None
    assert "none.jsonl" in person.questions[2]
    with pytest.raises(RecordError, match=r"session damaged\.jsonl, line"):
        await errand(Scripted(), "session", "damaged.jsonl")


async def test_what_is_done_with_a_session_is_asked(folder: Path) -> None:
    assert await errand(Scripted("Diagnose"), "session", AFTER) == ("diagnose", Path(AFTER), None)
    assert await errand(Scripted(None), "session", AFTER) is None
    person = Scripted("Replay")
    choice = SessionChoice(person, recent_sessions(Path()), read_only=True)
    assert await choice.errand("session", AFTER) == ("replay", Path(AFTER), None)
    assert "Export the joint offsets" not in person.offered[0]


async def test_a_comparison_has_the_session_after_or_its_partner(folder: Path) -> None:
    person = Scripted(BEFORE, AFTER)
    assert await errand(person, "compare") == ("compare", Path(BEFORE), Path(AFTER))
    assert person.questions == [
        texts.WHICH["before"],
        f"{BEFORE}\n{texts.WHICH['after']}",
    ]
    verifying = opened().model_copy(update={"verifies": BEFORE})
    write(folder / "verify.jsonl", [verifying], close=True)
    person = Scripted("Compare")
    both = "compare", Path(BEFORE), Path("verify.jsonl")
    assert await errand(person, "compare", "verify.jsonl") == both
    assert await errand(Scripted(None), "compare", "verify.jsonl") is None
    person = Scripted("Another", AFTER)
    assert await errand(person, "compare", "verify.jsonl") == (both[0], both[2], Path(AFTER))
    person = Scripted(None)
    assert await errand(person, "compare", BEFORE) is None
    assert person.proposed[0].startswith("verify.jsonl"), "it verifies this one"


async def test_sessions_of_postures_have_no_comparison_here(folder: Path) -> None:
    name = posture_session(folder / "postures.jsonl", "position", 12).name
    with pytest.raises(UsageError, match="glidecal verify BEFORE AFTER"):
        await errand(Scripted(), "compare", name)


async def test_ports_of_another_computer_are_asked_for(folder: Path) -> None:
    elsewhere: dict[str, Any] = {
        "computer": "another",
        "instruments": (Instrument(profile="sylvac", port="COM5", axes="yx"),),
    }
    path = write(folder / "begun.jsonl", [opened().model_copy(update=elsewhere)], close=False)
    person = Scripted("sylvac:/dev/ttyUSB0@yx")
    plan = await plan_to_go_on(person, path)
    assert plan is not None
    assert [instrument.port for instrument in plan.instruments] == ["/dev/ttyUSB0"]
    assert "another computer" in person.questions[0]
    assert await plan_to_go_on(Scripted(""), path) is None


def test_a_folder_stands_for_its_sessions(folder: Path) -> None:
    folders, files = named_sessions([folder / BEFORE, folder, folder])
    assert folders == [folder]
    assert files[0] == folder / BEFORE
    assert sorted(path.name for path in files) == [AFTER, BEFORE, "damaged.jsonl"]
