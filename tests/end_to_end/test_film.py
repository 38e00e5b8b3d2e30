"""README's walk at three sizes: every station shows what is promised, and no line is cut."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.conftest import LONG
from tests.end_to_end.film import SIZES, filmed

pytestmark = pytest.mark.skipif(shutil.which("tmux") is None, reason="tmux is not installed")


@LONG
@pytest.mark.parametrize("size", SIZES)
def test_the_walk_of_readme(size: tuple[int, int], tmp_path: Path) -> None:
    columns, rows = size
    stations = filmed(columns, rows, tmp_path)
    assert {station.name: station.missing for station in stations if station.missing} == {}
    cuts = {station.name: station.cut(columns) for station in stations}
    assert {name: cut for name, cut in cuts.items() if cut} == {}
    assert stations[-1].name == "end", "the whole walk"
    assert len([*tmp_path.glob("*.txt")]) == len(stations)
    head, *events = map(json.loads, (tmp_path / "film.cast").read_text("utf-8").splitlines())
    assert (head["version"], head["width"], head["height"]) == (2, columns, rows)
    times = [at_s for at_s, kind, _ in events if kind == "o"]
    assert len(times) == len(events) > len(stations)
    assert times == sorted(times)
