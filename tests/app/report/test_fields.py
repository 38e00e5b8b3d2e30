"""A field of a result is one line: everything that shows results shows it from there."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
from pydantic import TypeAdapter

from app.report.pages.report import html_of
from app.report.pages.two_pages import PrintedPage, Section
from app.report.schema.document import Report, Source, to_json
from app.report.text.tables import result_table, table_text
from calib.quantity import Quantity
from protocols.data_table import DataTable
from tests.conftest import LONG, ROOT


@dataclass(frozen=True)
class Play:
    """What a joint has."""

    joint: Annotated[str, Quantity("joint")]
    size_mm: Annotated[float, Quantity("play", "mm", "measured", 3)]
    expanded_mm: Annotated[float, Quantity("± U (95 %)", "mm", "uncertainty", 3)]


@dataclass(frozen=True)
class PlayAndWear(Play):
    """With one field more."""

    wear: Annotated[float | None, Quantity("wear", "µm", "two-digit", None, "since new", "none")]


class PlayReport(Report):
    """A toy document."""

    of = Source[tuple[Play, ...]]()
    joints: tuple[Play, ...] = of(lambda r: r)


class WearReport(Report):
    """The same of the other class."""

    of = Source[tuple[PlayAndWear, ...]]()
    joints: tuple[PlayAndWear, ...] = of(lambda r: r)


PLAYS = (Play("x", 0.01234, 0.00021), Play("y", -0.5, 0.2))
WORN = (PlayAndWear("x", 0.01234, 0.00021, 12.34), PlayAndWear("y", -0.5, 0.2, None))


def forms(kind: type[Play], joints: tuple[Play, ...], document: Report) -> dict[str, str]:
    """Everywhere that a result stands."""
    table = DataTable.of(kind, joints)
    csv = table.file_content("csv")
    assert isinstance(csv, str)
    return {
        "json": to_json(document),
        "schema": json.dumps(
            TypeAdapter(type(document)).json_schema(mode="serialization"), ensure_ascii=False
        ),
        "terminal": table_text(result_table(kind, joints)),
        "page": html_of(
            PrintedPage("toys", "", [], [Section("Joints", [result_table(kind, joints)])])
        ),
        "notebook": table._repr_html_(),
        "spreadsheet": csv,
    }


def test_a_field_more_is_everywhere() -> None:
    without = forms(Play, PLAYS, PlayReport.of(PLAYS))
    worn = forms(PlayAndWear, WORN, WearReport.of(WORN))
    assert not [form for form, text in without.items() if "wear" in text]
    for form, words in {
        "json": '"wear": 12.34',
        "schema": '"description": "since new"',
        "terminal": "wear, µm",
        "page": "wear, µm",
        "notebook": '<th title="since new">wear, µm</th>',
        "spreadsheet": "joint,size_mm,expanded_mm,wear_µm",
    }.items():
        assert words in worn[form], form
    assert worn["terminal"].splitlines()[2].split() == ["x", "+0.01234", "0.00021", "12"]
    assert worn["terminal"].splitlines()[3].split() == ["y", "-0.500", "0.200", "none"]
    assert worn["notebook"].count("<tr>") == 3
    assert worn["spreadsheet"].splitlines()[1:] == ["x,0.01234,0.00021,12.34", "y,-0.5,0.2,"]
    assert DataTable.of(PlayAndWear, WORN).to_frame()["wear_µm"].tolist()[0] == 12.34


def test_text_of_others_is_no_markup_in_a_notebook() -> None:
    html = DataTable.of(Play, [Play("<b>x</b>", 1.0, 1.0)])._repr_html_()
    assert "<b>" not in html
    assert "&lt;b&gt;x" in html


@pytest.mark.parametrize(
    ("quantity", "value", "text"),
    [
        (Quantity("a", kind="signed", decimals=2), -0.0001, "+0.00"),
        (Quantity("a", kind="uncertainty", decimals=3), 0.0, "0.0000010"),
        (Quantity("a", decimals=1), 0.25, "0.2"),
        (Quantity("a"), 0.25, "0.25"),
        (Quantity("a", kind="tolerance"), 0.4, "0.4"),
        (Quantity("a", kind="tolerance"), 0.2 * math.sqrt(2.0), "0.283"),
        (Quantity("a"), 7, "7"),
        (Quantity("a", missing="not determined"), None, "not determined"),
    ],
)
def test_a_value_as_its_field_says(quantity: Quantity, value: object, text: str) -> None:
    assert quantity.shown(value) == text


WRONG = """
from app.report.schema.document import Report, Source
from tests.app.report.test_fields import Play

class Wrong(Report):
    of = Source[Play]()
    missing: float = of(lambda r: r.wear)
    joint: float = of(lambda r: r.joint)
    right: str = of(lambda r: r.joint)

Wrong.of("x")
"""


@LONG
def test_a_type_checker_sees_what_a_key_is_read_from(tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text(WRONG, encoding="utf-8")
    command = (sys.executable, "-m", "mypy", "--strict", str(tmp_path / "wrong.py"))
    run = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
    faults = [line.partition("error: ")[2] for line in run.stdout.splitlines() if "error:" in line]
    assert len(faults) == 3, run.stdout
    assert '"Play" has no attribute "wear"' in faults[0]
    assert 'expression has type "str", variable has type "float"' in faults[1]
    assert 'incompatible type "str"; expected "Play"' in faults[2]
