"""docs/hexaslide.md: its script runs, and what is committed says what is true."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from app.planning.hexaslide import Request, hexaslide_planning
from calib.arrays import FloatArray
from calib.hexaslide.planning import conditions_at, look_at
from protocols.hexaslide import load_postures
from studies.hexaslide import SETS
from tests.conftest import LONG, ROOT, first_quick

PAGE = ROOT / "docs" / "hexaslide.md"

RANKS = {
    "I, pose-inverse": (49, 49, 49, 9),
    "II, pose-forward": (49, 49, 49, 9),
    "III, position": (49, 48, 46, 16),
    "IV, constraint-link": (55, 46, 48, 48),
}
"""Parameters, the paper's rank, the true one, fewest postures."""

PAPER = {
    "pose-inverse": "9: 2888 → 140.2",
    "pose-forward": "9: 21530 → 1537.3",
    "position": "16: 33916 → 2430.2",
    "constraint-link": "46: 601200 → 145230",
}
LIMITS = {"pose-inverse": 48, "pose-forward": 390, "position": 205, "constraint-link": 930}
"""Condition numbers that a good search stays below; H60, metres and radians."""

RECIPE = {"pose-forward": (49, 49), "position": (48, 46), "constraint-link": (46, 48)}
"""What the paper's recipe gives at its number of postures, and the truth."""

POSTURES = {"pose-inverse": 9, "pose-forward": 9, "position": 16, "constraint-link": 48}
BOX = ((-0.3, 0.3), (-1.1, -0.5), (-1.3, -1.0), (-15.0, 15.0), (-15.0, 15.0), (-30.0, 30.0))


def rows(page: str, heading: str) -> dict[str, list[str]]:
    """The rows of the first table below a heading or within a section, by their first cell."""
    below = page[page.index(heading) :]
    table = re.search(r"^\|.*(?:\n\|.*)*", below, re.MULTILINE)
    assert table is not None
    cells = [[c.strip() for c in line.split("|")[1:-1]] for line in table.group().splitlines()]
    return {row[0]: row[1:] for row in cells[2:]}


def posture_sets(folder: Path) -> dict[str, FloatArray]:
    """The posture tables beside the page, metres and degrees, by procedure."""
    paths = [folder / f"hexaslide-{name}.csv" for name in POSTURES]
    return {path.stem.removeprefix("hexaslide-"): in_degrees(path) for path in paths}


def in_degrees(path: Path) -> FloatArray:
    postures = load_postures(path)
    return np.hstack([postures[:, :3], np.degrees(postures[:, 3:])])


def page_made(option: str, path: Path) -> subprocess.CompletedProcess[str]:
    """The script with little effort."""
    return subprocess.run(
        [sys.executable, "-m", "studies.hexaslide", "--quick", option, str(path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=800,
        check=False,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONUTF8": "1"},
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page as the script makes it now, with little effort."""
    path = tmp_path_factory.mktemp("page") / "made [x].md"
    run = page_made("--output", path)
    assert run.returncode == 0, run.stderr
    return path


@pytest.fixture(params=first_quick(["committed", "made"]))
def path(request: pytest.FixtureRequest) -> Path:
    if request.param == "committed":
        return PAGE
    study_page = request.getfixturevalue("made")
    assert isinstance(study_page, Path)
    return study_page


@pytest.fixture
def page(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def test_ranks_beside_the_papers(page: str) -> None:
    table = rows(page, "## What is seen")
    assert set(table) == set(RANKS)
    for name, (count, published, rank, fewest) in RANKS.items():
        row = table[name]
        assert row[:3] == [f"{count}", f"{published}", f"**{rank}**"]
        assert row[5] == f"{fewest}"


def test_row_counts_and_the_papers_recipe(page: str) -> None:
    counts = rows(page, "exchanged, and they are its numbers of rows")
    assert "15: 45 rows, rank 45; 16: 48 rows, rank 46" in counts["position"][0]
    assert (
        "46: 46 rows, rank 46; 47: 47 rows, rank 47; 48: 48 rows, rank 48"
        in (counts["constraint-link"][0])
    )
    recipe = rows(page, "The paper takes differences")
    for name, (feigned, true) in RECIPE.items():
        assert recipe[name][1].endswith(f": {feigned}")
        assert recipe[name][3] == f"{true}"


def test_condition_numbers_beside_the_papers(page: str) -> None:
    table = {row[0]: row[1:] for row in rows(page, "## Random and optimum").values()}
    assert {name: row[0] for name, row in table.items()} == PAPER
    for row in table.values():
        best = float(row[2].strip("*"))
        printed = float(row[0].split("→")[1])
        assert best < printed


def test_the_committed_optima_stay_below_the_limits() -> None:
    text = PAGE.read_text(encoding="utf-8")
    table = {row[0]: row[1:] for row in rows(text, "## Random and optimum").values()}
    for name, limit in LIMITS.items():
        assert float(table[name][2].strip("*")) < limit, name


def test_posture_sets_are_whole_and_in_the_box(path: Path) -> None:
    table = posture_sets(path.parent / SETS)
    assert {name: len(postures) for name, postures in table.items()} == POSTURES
    low, high = np.transpose(BOX)
    for postures in table.values():
        assert np.all((postures >= low - 1e-9) & (postures <= high + 1e-9))


def test_the_committed_sets_have_the_condition_numbers_of_the_page() -> None:
    table = {row[0]: row[1:] for row in rows(PAGE.read_text("utf-8"), "## Random").values()}
    for name in POSTURES:
        view = look_at(hexaslide_planning(Request(name)))
        postures = load_postures(PAGE.parent / SETS / f"hexaslide-{name}.csv")
        stated = float(table[name][2].strip("*"))
        assert conditions_at(view, postures)["m, rad"] == pytest.approx(stated, rel=0.01)


def test_a_tilt_measured_too(page: str) -> None:
    table = rows(page, "## Any measured components")
    assert table["`x,y,z,theta`"][:2] == ["48 of 49", "turns Z"]
    assert table["`x,y,z,theta,psi,phi`"][0] == "49 of 49"


@LONG
def test_the_committed_page_is_that_of_the_script(made: Path) -> None:
    """Sentences, not numbers: everything outside tables and commands."""
    committed = PAGE.read_text(encoding="utf-8")
    assert sentences(committed) == sentences(made.read_text(encoding="utf-8"))


def sentences(text: str) -> list[str]:
    """Paragraphs of the page with their numbers taken out."""
    sections = [part for part in text.split("\n\n") if not part.startswith(("|", "    "))]
    return [re.sub(r"\d[\d.e]*|\s+", " ", part) for part in sections]


def numbers(table: Mapping[str, list[str]]) -> list[float]:
    """Condition numbers of the column of random medians."""
    return [float(row[2].split(":")[1].split("(")[0]) for row in table.values()]


def test_random_medians_are_of_the_papers_size() -> None:
    """Within a factor of ten of Tables 3 and 4, whose ranks the paper has right."""
    text = PAGE.read_text(encoding="utf-8")
    inverse, forward, *_ = numbers(rows(text, "## Random and optimum"))
    assert 288.8 < inverse < 28880.0
    assert 2153.0 < forward < 215300.0


def test_a_missing_machine_file_is_told(tmp_path: Path) -> None:
    path = tmp_path / "none.toml"
    run = page_made("--machine-file", path)
    assert run.returncode != 0
    assert "none.toml" in run.stderr
    assert "Traceback" not in run.stderr
