"""Pictures of the documentation show the program of today."""

from __future__ import annotations

import html
import re
from pathlib import Path

import pytest

from studies import pictures, setting
from tests.conftest import LONG, ROOT
from tests.screens.test_pictures import other_versions

WORD = re.compile(r"[A-Za-z_]{3,}")
"""Readings differ from run to run, and with them digits and what charts draw."""


def words_of(picture: Path) -> list[str]:
    """What can be read, in the order of its rows."""
    parts = re.findall(r"<text [^>]*>(.*?)</text>", picture.read_text("utf-8"), re.DOTALL)
    return WORD.findall(html.unescape(" ".join(parts)).replace("\xa0", " "))


@LONG
@pytest.mark.skipif(bool(other_versions()), reason="other versions draw otherwise")
def test_the_pictures_are_those_of_this_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where they are not: python -m studies.pictures, and look at them."""
    monkeypatch.setattr(pictures, "PICTURES", tmp_path)
    pictures.main()
    made = sorted(tmp_path.glob("*.svg"))
    assert len(made) >= 11
    stored = ROOT / "docs" / "pictures"
    old = [p.name for p in made if words_of(p) != words_of(stored / p.name)]
    assert not old, "made again by python -m studies.pictures"
    assert all(len(words_of(picture)) > 10 for picture in made), "no empty screens"


def test_the_drawing_is_that_of_its_script() -> None:
    assert setting.TARGET.read_text("utf-8") == setting.picture()
