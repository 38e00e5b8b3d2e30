"""Tables of a benchmark run on their page, and their pictures."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from benchmarks.page import (
    DRAWN,
    cells,
    rows_of,
    shares,
    tables_of,
    with_tables,
    with_versions,
    write_pictures,
)
from benchmarks.postures import figaroh

PAGE = """# Words

Python 3.0, old

| one session: few | ms | ratio |
|---|---|---|
| glidecal | 9.0 | 1.0 |

between

| other | s |
|---|---|
| kept | 1 |
"""

NEW = [
    "| one session: few | ms | ratio |",
    "|---|---|---|",
    "| glidecal, prepared | 0.200 | 1.0 |",
    "| iminuit | 60.0 | 300 |",
    "| lmfit | not installed | |",
]

NOTHING: dict[str, None] = {}

BENCHMARKS = Path(__file__).parents[2] / "docs" / "benchmarks.md"


def test_a_table_takes_the_place_of_the_one_with_its_heading() -> None:
    page, strangers = with_tables(PAGE, [NEW, ["| new | s |", "|---|---|", "| a | 1 |"]])
    assert page == PAGE.replace("| glidecal | 9.0 | 1.0 |", "\n".join(NEW[2:]))
    assert strangers == ["new"]
    assert with_tables(page, [])[0] == page


def test_versions_are_replaced_and_nothing_else() -> None:
    assert with_versions(PAGE, "Python 3.11") == PAGE.replace("Python 3.0, old", "Python 3.11")


def test_tables_are_found_between_other_lines() -> None:
    assert [table[0] for table in tables_of([*NEW, "", *NEW, "words"])] == [NEW[0], NEW[0]]


def test_lengths_of_bars() -> None:
    lengths, logarithmic = shares(rows_of(NEW, "ms"))
    assert logarithmic
    assert lengths == pytest.approx([0.1083, 1.0, 0.0], abs=1e-4)  # from 0.1 to 60
    near = ["| a | ms |", "|---|---|", "| x | 2.0 |", "| y | 4.0 |"]
    assert shares(rows_of(near, "ms")) == ([0.5, 1.0], False)


def test_figures_with_commas_and_exponents() -> None:
    table = ["| a | b |", "|---|---|", "| x | 1,000 |", "| y | 3.9e+05 |", "| z | none |"]
    assert [row.value for row in rows_of(table, "b")] == [1000.0, 3.9e5, None]


def test_a_picture_shows_the_figures_of_its_table(tmp_path: Path) -> None:
    (path,) = write_pictures([NEW, ["| other | s |", "|---|---|", "| kept | 1 |"]], tmp_path)
    assert path == tmp_path / "bench_identification.svg"
    text = "".join(ElementTree.parse(path).getroot().itertext()).replace("\xa0", " ")
    for word in ("glidecal, prepared", "0.200", "60.0", "lmfit", "not installed", "logarithmic"):
        assert word in text
    assert "font-face" not in path.read_text()


def test_the_page_links_each_picture_and_its_tables_have_the_columns() -> None:
    text = BENCHMARKS.read_text()
    tables = tables_of(text.splitlines())
    for drawn in DRAWN:
        assert f"](pictures/{drawn.picture}.svg)" in text
        assert (BENCHMARKS.parent / "pictures" / f"{drawn.picture}.svg").is_file()
        (table,) = (t for t in tables if cells(t[0])[0].startswith(drawn.table))
        for column in drawn.columns:
            assert sum(row.value is not None for row in rows_of(table, column)) >= 2
    assert len(re.findall(r"\]\(pictures/", text)) == len(DRAWN)


def test_a_python_without_figaroh_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.delenv("FIGAROH_PYTHON", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", NOTHING.get)
    assert figaroh() is None
    monkeypatch.setenv("FIGAROH_PYTHON", str(tmp_path / "none"))
    assert figaroh() is None
    assert "is no program" in capsys.readouterr().err
    bare = tmp_path / "python"
    bare.write_text("#!/bin/sh\necho 'No module named figaroh' >&2\nexit 1\n")
    bare.chmod(0o755)
    monkeypatch.setenv("FIGAROH_PYTHON", str(bare))
    assert figaroh() is None
    assert "figaroh: No module named figaroh" in capsys.readouterr().err
