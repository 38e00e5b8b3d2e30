"""The number of the record's schema: it moves with the record, and older numbers stay readable."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from app.report.schema.schemas import FrozenSchema, meaning, schemas, write_schemas
from protocols.journal import Journal
from protocols.record import read_record
from protocols.session import SCHEMA, SCHEMA_NUMBER, Event
from tests.app.cli import glidecal, refused
from tests.conftest import ROOT, first_quick
from tests.recorded import compact, story, write

SCHEMAS = ROOT / "docs" / "schemas"
CORPUS = ROOT / "sample_sessions" / "every_schema"
HIDDEN_MM = (0.85, -1.3, 0.4)
HIDDEN_LENGTHS_MM = (0.02, -0.03, 0.01)
NEXT = SCHEMA_NUMBER + 1


def records(number: int) -> list[Path]:
    return sorted((CORPUS / f"{number}").glob("*.jsonl"))


EVERY = [path for number in range(1, NEXT) for path in records(number)]
WRITTEN_DOWN = [path for path in EVERY if path.stem != "first-day"]
"""That one has a key that was gone before the first schema was written down."""


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()]


def test_a_changed_event_has_a_new_number() -> None:
    """Keys, types, bounds and what must be there; descriptions may change."""
    file = f"session-{SCHEMA_NUMBER}.json"
    assert meaning((SCHEMAS / file).read_text("utf-8")) == meaning(schemas()[file]), (
        f"A line of the record changed: add glidecal.session/{NEXT} to SchemaId in "
        "protocols/session.py; then make schemas, make records."
    )


def test_the_schema_of_a_number_is_not_written_over(tmp_path: Path) -> None:
    file = tmp_path / f"session-{SCHEMA_NUMBER}.json"
    write_schemas(tmp_path)
    former = json.loads(file.read_text("utf-8"))
    noted = former["$defs"]["Noted"]
    noted["description"] = "Another sentence."
    file.write_text(json.dumps(former), "utf-8")
    write_schemas(tmp_path)
    assert "Another sentence." not in file.read_text("utf-8")
    del noted["properties"]["text"]
    file.write_text(json.dumps(former), "utf-8")
    with pytest.raises(FrozenSchema, match=f"glidecal.session/{NEXT}"):
        write_schemas(tmp_path)
    assert json.loads(file.read_text("utf-8")) == former


def test_every_number_has_its_schema_and_its_records() -> None:
    assert f"glidecal.session/{SCHEMA_NUMBER}" == SCHEMA
    assert {path.name for path in SCHEMAS.glob("session-*.json")} == {
        f"session-{number}.json" for number in range(1, NEXT)
    }
    assert sorted(int(folder.name) for folder in CORPUS.iterdir()) == list(range(1, NEXT))
    for number in range(1, NEXT):
        schemas_named = {lines(path)[0]["schema"] for path in records(number)}
        assert schemas_named == {f"glidecal.session/{number}"}


def test_the_records_of_this_number_have_every_event_and_key() -> None:
    keys_by_event: dict[str, set[str]] = defaultdict(set)
    for path in records(SCHEMA_NUMBER):
        for line in lines(path):
            keys_by_event[line["event"]] |= {
                key for key, value in line.items() if value not in (None, {})
            }
    for kind in get_args(get_args(Event)[0]):
        name = kind.model_fields["event"].default
        keys = {field.alias or key for key, field in kind.model_fields.items()}
        assert keys - keys_by_event[name] == set(), (
            f"event {name}: add it to sample_sessions/make.py"
        )


@pytest.mark.parametrize(
    "path", first_quick(EVERY), ids=lambda path: f"{path.parent.name}-{path.stem}"
)
def test_a_record_of_every_number_is_read_checked_and_solved(path: Path) -> None:
    record = read_record(path)
    assert record.end == "closed"
    assert glidecal("validate", path).status == 0
    run = glidecal("solve", path, "--json")
    assert run.status == 0, run.err
    solution = json.loads(run.out)["parameters"]
    offsets_mm = np.array([solution[f"d_rho_{leg}"]["value"] for leg in "xyz"])
    hidden_mm = np.array(HIDDEN_MM)
    if path.stem in {"first-day", "unsealed"}:  # their bars hid something, too
        hidden_mm = hidden_mm - HIDDEN_LENGTHS_MM
    if path.stem in {"plate", "contacts"}:  # it does not show what all three towers share
        offsets_mm, hidden_mm = offsets_mm - offsets_mm.mean(), hidden_mm - hidden_mm.mean()
    assert offsets_mm == pytest.approx(hidden_mm, abs=0.02)


@pytest.mark.parametrize("path", WRITTEN_DOWN, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_line_keeps_the_schema_of_its_number(path: Path) -> None:
    text = (SCHEMAS / f"session-{path.parent.name}.json").read_text("utf-8")
    schema = Draft202012Validator(json.loads(text))
    assert [fault for line in lines(path) for fault in schema.iter_errors(line)] == []


def newer(path: Path, changed: dict[str, dict[str, Any]]) -> Path:
    """A record of this program with keys of events changed."""
    events = [compact(line | changed.get(line["event"], {})) for line in lines(path)]
    path.write_bytes(b"".join(line + b"\n" for line in events))
    return path


def words(number: int) -> str:
    return (
        f"written by a newer glidecal (record schema {number}; this one reads up to "
        f"{SCHEMA_NUMBER}): update glidecal."
    )


def test_a_record_of_a_newer_program_is_refused_in_these_words(tmp_path: Path) -> None:
    path = write(tmp_path / "a.jsonl", story(), close=True)
    newer(path, {"opened": {"schema": f"glidecal.session/{NEXT}", "unheard": 1}})
    for verb in (("solve",), ("diagnose",), ("validate",), ("replay", "--headless")):
        assert words(NEXT) in refused(3, *verb, path)
    assert words(NEXT) in refused(3, "run", "--continue", path)


def test_so_is_one_that_a_newer_program_continued(tmp_path: Path) -> None:
    path = write(tmp_path / "a.jsonl", story(), close=True)
    newer(path, {"continued": {"schema": f"glidecal.session/{NEXT}", "unheard": 1}})
    assert words(NEXT) in refused(3, "solve", path)


@pytest.mark.parametrize(
    "schema",
    ["glidecal.session/0", "glidecal.session/02", "glidecal.session/x", "other/9", 9, None],
)
def test_what_names_no_number_is_no_session(tmp_path: Path, schema: object) -> None:
    path = write(tmp_path / "a.jsonl", story(), close=True)
    newer(path, {"opened": {"schema": schema}})
    message = refused(3, "solve", path)
    assert "newer" not in message
    assert "Not a session file" in message


def test_a_continued_record_tells_the_schema_of_the_program_that_went_on(tmp_path: Path) -> None:
    """The first line stays; what comes behind may be of a later number."""
    path = write(tmp_path / "a.jsonl", story(), close=False)
    Journal.resume(path, "a later test").close()
    assert lines(path)[-1]["schema"] == SCHEMA
