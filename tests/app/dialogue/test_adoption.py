"""What is made of a diagnosis, of a person who answers from a list."""

from __future__ import annotations

import asyncio
from pathlib import Path

from app.dialogue.adoption import AdoptionDialogue
from protocols.model_file import read_model_file
from tests.app.dialogue.scripted import Scripted
from tests.hidden_sessions import bowed_session


def test_what_is_named_goes_into_a_model_and_is_diagnosed_with_it(tmp_path: Path) -> None:
    session = bowed_session(tmp_path)
    model = session.with_name("bow [x]_model.json")
    person = Scripted(None, "adopt leg_bow", None, "adopt leg_bow", str(model))
    adopting = AdoptionDialogue(person, [session])
    diagnosed, adopted = adopting.diagnose()
    assert adopted == ""
    assert not asyncio.run(adopting.adopt(diagnosed)), "no choice"
    assert not asyncio.run(adopting.adopt(diagnosed)), "no path"
    assert not model.exists()
    assert asyncio.run(adopting.adopt(diagnosed))
    assert [effect.id for effect in read_model_file(model).effects] == ["leg_bow"]
    assert person.lines == [f"Model written: {model}. Diagnosing again with it."]
    assert adopting.is_stale()
    _, adopted = adopting.diagnose()
    assert adopted.startswith(f"Adopted in {model.name}: gap ")
    assert not adopting.is_stale()
