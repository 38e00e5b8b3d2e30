"""Every ``--json`` keeps to its schema in ``docs/schemas``, and the schemas to the program.

After a change that is meant: make schemas
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pydantic
import pytest
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError

from app.report.schema.document import Report, Source, to_json
from app.report.schema.readings import outcome_report
from app.report.schema.schemas import record_forms, result_rows, schemas, with_columns
from calib.diagnosis.results import Gap
from calib.quantity import quantities
from drivers.profile import Fault, FaultKind, IndicatorReading
from tests.app.cli import glidecal
from tests.conftest import ROOT

FOLDER = ROOT / "docs" / "schemas"
ID = re.compile(r"glidecal\.([a-z-]+)/(\d+)")
SAMPLES = ROOT / "sample_sessions"
TWELVE, THREE = (str(SAMPLES / f"experiment_{n}_twelve.jsonl") for n in (2, 3))
SWEEP, SHORT = (str(SAMPLES / f"simulated_{name}.jsonl") for name in ("sweep", "zero-max-min"))
EXTRAS = ("--tolerance", "0.3", "--map", "--monte-carlo", "20", "--subset", "both")


@pytest.mark.skipif(
    tuple(map(int, pydantic.VERSION.split(".")[:2])) < (2, 14),
    reason="docs/schemas are as pydantic 2.14 describes classes; older ones leave keys out",
)
def test_the_schemas_are_those_of_the_program() -> None:
    former = {
        f"{form.name.removeprefix('glidecal.')}-{number}.json"
        for form in record_forms().values()
        for number in range(1, form.number)
    }
    assert {"session-6.json", "hexaslide-session-1.json"} <= former
    files = {path.name: path.read_text(encoding="utf-8") for path in FOLDER.iterdir()}
    assert {name: text for name, text in files.items() if name not in former} == schemas(), (
        "make schemas"
    )


def test_the_glossary_explains_the_columns_of_tables() -> None:
    glossary = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    assert glossary == with_columns(glossary), "make schemas"
    fields = [quantity for kind in result_rows() for quantity in quantities(kind).values()]
    assert len(fields) > 40
    assert all(quantity.words for quantity in fields if quantity.label is not None)


def test_every_id_of_the_program_has_a_schema() -> None:
    sources = [path for room in ("app", "protocols") for path in (ROOT / room).rglob("*.py")]
    ids = {
        f"{name}-{number}"
        for path in sources
        for name, number in ID.findall(path.read_text(encoding="utf-8"))
    }
    assert ids == {path.stem for path in FOLDER.iterdir()}


def kept(text: str) -> str:
    """The name of the document's schema, which it keeps."""
    document = json.loads(text)
    match = ID.fullmatch(document["schema"])
    assert match is not None
    schema = json.loads((FOLDER / f"{match[1]}-{match[2]}.json").read_text(encoding="utf-8"))
    Draft202012Validator(schema).validate(document)
    return match[1]


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("solution", ("solve", TWELVE)),
        ("solution", ("solve", SWEEP, *EXTRAS)),
        ("diagnosis", ("diagnose", TWELVE)),
        ("diagnosis", ("diagnose", SWEEP, "--held-out", THREE)),
        ("aliases", ("diagnose", "--aliases")),
        ("comparison", ("compare", TWELVE, THREE)),
        ("replay", ("replay", TWELVE)),
        ("ports", ("ports",)),
        ("plan", ("plan", SHORT)),
        ("identifiability", ("identifiability", "orthoglide", "--procedure", "sweep")),
        (
            "identifiability",
            ("identifiability", "hexaslide", "--procedure", "position", "--postures", "20"),
        ),
        (
            "postures",
            ("postures", "orthoglide", "--procedure", "verify", "--count", "18", "--starts", "1"),
        ),
    ],
)
def test_every_verb_keeps_its_schema(name: str, command: tuple[str, ...]) -> None:
    run = glidecal(*command, "--json")
    assert run.status == 0, run.err
    assert kept(run.out) == name


def test_a_hexa_slide_keeps_its_schemas(tmp_path: Path) -> None:
    measured, truth, table = (str(tmp_path / n) for n in ("m.json", "t.json", "p.csv"))
    options = ("--procedure", "pose-forward", "--postures", "16", "--seed", "3")
    glidecal("simulate", "--machine", "hexaslide", *options, "-o", measured, "--truth", truth)
    for path, name in ((measured, "hexaslide-measurements"), (truth, "hexaslide-truth")):
        assert kept(Path(path).read_text(encoding="utf-8")) == name
    assert kept(glidecal("solve", measured, "--truth", truth, "--json").out) == (
        "hexaslide-calibration"
    )
    record = json.loads(Path(measured).read_text(encoding="utf-8"))
    rows = [",".join(map(repr, posture["values"])) for posture in record["postures"]]
    head = "x_m,y_m,z_m,theta_deg,psi_deg,phi_deg"
    Path(table).write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    judged = ("--procedure", "pose-forward", "--posture-file", table, "--as-is", "--json")
    assert kept(glidecal("postures", "hexaslide", *judged).out) == "postures"


def test_exported_and_adopted_files_keep_their_schemas(tmp_path: Path) -> None:
    for form, name in (("json", "offsets"), ("model", "model")):
        path = tmp_path / form
        assert glidecal("export", TWELVE, "--format", form, "-o", path).status == 0
        assert kept(path.read_text(encoding="utf-8")) == name


def test_readings_and_faults_keep_their_schema() -> None:
    text = to_json(outcome_report("p", IndicatorReading("+1.5", 1.5, 0.1, unit_assumed=True)))
    fault = to_json(outcome_report("p", Fault(FaultKind.NO_ANSWER, "", "none: is it on?")))
    assert kept(text) == kept(fault) == "reading"
    assert "value_mm" not in json.loads(fault)
    with pytest.raises(ValidationError):
        kept(text.replace('"value_mm": 1.5', '"value_mm": "1.5"'))


class Judgement(Report):
    """Of two kinds of figures: its own, and those of a result as it stands."""

    of = Source[tuple[Gap, float]]()
    gap: Gap = of(lambda judged: judged[0])
    figure: float = of(lambda judged: judged[1])


@pytest.mark.parametrize("wrong", [math.nan, math.inf])
def test_no_figure_leaves_that_is_not_finite(wrong: float) -> None:
    gap = Gap(rms_mm=1.0, chi_square=1.0, degrees_of_freedom=1, p_value=0.5)
    assert '"figure": 1.0' in to_json(Judgement.of((gap, 1.0)))
    with pytest.raises(ValueError, match="JSON"):
        to_json(Judgement.of((gap, wrong)))
    with pytest.raises(ValueError, match="JSON"):
        to_json(Judgement.of((Gap(wrong, 1.0, 1, 0.5), 1.0)))
