"""The report: figures of the solution in it, the same bytes twice, nothing of a stranger active."""

from __future__ import annotations

import builtins
import math
import re
import shutil
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import replace
from html.parser import HTMLParser
from itertools import cycle
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.textpath import TextPath
from rich.table import Table

from app.evaluating.comparison import reported_pair
from app.evaluating.diagnosis import diagnose_files
from app.evaluating.solution import judge, solve_files
from app.report.certificate import CertificateHead
from app.report.charts.charts import Chart, Series
from app.report.charts.results import residuals_before_and_after
from app.report.pages.figures import svg_of
from app.report.pages.report import WIDTH_EM, html_of, pdf_of, widths_em
from app.report.pages.two_pages import CalibrationReport, Picture, Section
from app.report.text.tables import new_table
from calib.errors import UsageError, extra
from calib.printable import HIDDEN, printable
from protocols.certificate import CertificateOrder, Laboratory
from protocols.journal import write_whole
from protocols.record import read_record
from protocols.session import Line, Noted, Restored, Skipped, Superseded
from tests.app.cli import glidecal
from tests.app.report.certificates import report_of
from tests.conftest import LONG, SAMPLES
from tests.hidden_sessions import write_session

EXPERIMENT = SAMPLES / "experiment_2_twelve.jsonl"
SIMULATED = SAMPLES / "simulated_zero-max-min.jsonl"

BUDGET = "Uncertainty budget of these parameters"

HOSTILE = (
    "<script>alert(1)</script>",
    "</td></table><img src=x onerror=alert(1)>",
    "{{ 7 * 7 }}{% raw %}",
    "]]><svg onload=alert(1)>",
    '" onmouseover="alert(1)',
    "=1+1",
    "\x1b]0;owned\x07\u202etxt.exe",
    "$\\frac{1}{0}$ \\input{/etc/passwd}",
    "a\nb\r\u2028c",
    "&lt;b&gt;&#0;",
)


class Page(HTMLParser):
    """Elements with their attributes, and the text, of a page."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, tuple[str, ...]]] = []
        self.sources: list[str] = []
        self.words: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, tuple(name for name, _ in attrs)))
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


@pytest.fixture(scope="module")
def experiment() -> CalibrationReport:
    return report_of([EXPERIMENT])


def test_the_result_stands_in_it(experiment: CalibrationReport) -> None:
    """Numbers of `solve`, which other tests compare with the papers."""
    text = Page(html_of(experiment)).text
    solution = solve_files([EXPERIMENT]).solution
    view = text.partition("Parameters as the papers identify them")[2]
    for name, value in zip(solution.names, solution.values_mm, strict=True):
        match = re.search(rf"{name} ([+-][0-9.]+)", view)
        assert match, name
        assert float(match[1]) == pytest.approx(value, abs=1e-4)
    assert f"{solution.rms_before_mm:.4f} → {solution.rms_after_mm:.4f} mm" in text
    assert read_record(EXPERIMENT).digest in text
    assert "UNEXPLAINED" in text
    assert "times the noise: the identified parameters alone do not" in text
    rows = re.findall(r"leg [XYZ] at [+-]\d+ mm [+-]\d\.\d{4}", text)
    assert len(rows) == 18, "three postures on three legs along two axes"


def _cells(table: Table) -> list[tuple[str, ...]]:
    return [tuple(map(str, row)) for row in zip(*(c.cells for c in table.columns), strict=True)]


def _section(report: CalibrationReport, heading: str) -> Section:
    sections = [*report.first_page, *report.second_page, *report.sections]
    (section,) = (candidate for candidate in sections if candidate.heading == heading)
    return section


def _tables(section: Section) -> list[Table]:
    return [part for part in section.parts if isinstance(part, Table)]


def _pictures(section: Section) -> list[Picture]:
    return [part for part in section.parts if isinstance(part, Picture)]


def test_the_budget_adds_up_to_what_is_stated(experiment: CalibrationReport) -> None:
    (of_values,) = _tables(_section(experiment, BUDGET))
    result = solve_files([EXPERIMENT])
    stated = zip(result.solution.names, result.solution.expanded_with_tolerances_mm, strict=True)
    for row, (name, expanded_mm) in zip(_cells(of_values), stated, strict=True):
        assert row[0] == name
        scatter, steps, parts, together, residual = map(float, row[1:])
        assert math.hypot(scatter, steps, parts) == pytest.approx(expanded_mm, rel=0.01)
        assert together == pytest.approx(expanded_mm, rel=0.01)
        assert residual > scatter, "eleven times the noise is left"


def test_the_shares_of_the_budget_add_up(experiment: CalibrationReport) -> None:
    """Each beside the table: r.m.s. over the parameters, their squares up to the whole."""
    (picture,) = _pictures(_section(experiment, BUDGET))
    words = {"".join(element.itertext()) for element in ElementTree.fromstring(picture.svg).iter()}
    result = solve_files([EXPERIMENT])
    shares, sources = result.budget, result.solution.budget_mm
    together_mm2 = (result.solution.expanded_with_tolerances_mm**2).mean()
    total_mm2 = 0.0
    for share in shares:
        assert share.source in words
        square_mm2 = (sources[share.source] ** 2).mean()
        assert share.expanded_mm == pytest.approx(math.sqrt(square_mm2))
        total_mm2 += square_mm2
        assert share.cumulative == pytest.approx(total_mm2 / together_mm2, rel=1e-6)
    assert [s.source for s in shares] == sorted(
        sources, key=lambda name: -float((sources[name] ** 2).sum())
    )


@LONG
def test_what_to_enter_comes_on_top(tmp_path: Path) -> None:
    """The offsets of a session that was measured with some entered already."""
    record = read_record(SIMULATED)
    machine = record.opened.machine.model_copy(update={"entered_offsets_mm": (0.25, 0.0, -1.0)})
    path = tmp_path / "again.jsonl"
    opened = record.opened.model_copy(update={"machine": machine, "operator": "A. Fitter"})
    write_whole(path, opened, list(record.events[1:-1]))
    report = report_of([path])
    table, *_ = _tables(_section(report, "What to enter in the controller"))
    columns = zip(*(map(float, row[1:]) for row in _cells(table)), strict=True)
    current, change, _, together = columns
    assert current == (0.25, 0.0, -1.0)
    assert change == pytest.approx(solve_files([path]).joint_offsets_mm, abs=1e-4)
    assert together == pytest.approx(
        [a + b for a, b in zip(current, change, strict=True)], abs=1e-4
    )
    assert "A. Fitter" in Page(html_of(report)).text


@LONG
def test_a_session_that_verifies_another_is_reported_with_it(tmp_path: Path) -> None:
    """In the terminal, by key and in the browser alike; alone where the other file is gone."""
    before, after = tmp_path / "before.jsonl", tmp_path / "after.jsonl"
    shutil.copy(SIMULATED, before)
    record = read_record(before)
    opened = record.opened.model_copy(update={"verifies": before.name})
    write_whole(after, opened, [*record.events[1:-1]])
    pair = glidecal("report", before, "--after", after, "-o", "-").out
    assert "Measured again, with the offsets entered" in pair
    assert glidecal("report", after, "-o", "-").out == pair
    assert "No session after" in glidecal("report", before, "-o", "-").out
    assert reported_pair(after) == (before, after)
    changed = opened.machine.model_copy(update={"adjusted": "another bar"})
    rebuilt = opened.model_copy(update={"machine": changed})
    write_whole(tmp_path / "rebuilt.jsonl", rebuilt, [*record.events[1:-1]])
    assert reported_pair(tmp_path / "rebuilt.jsonl") == (tmp_path / "rebuilt.jsonl", None)
    before.unlink()
    assert "No session after" in glidecal("report", after, "-o", "-").out


@LONG
def test_readings_that_were_questioned_stand_by_themselves(tmp_path: Path) -> None:
    record = read_record(SIMULATED)
    path = tmp_path / "doubted.jsonl"
    doubted = Superseded(readings=(3, 4), reason="questioned: not as expected")
    restored = Restored(readings=(4,), reason="kept: looked twice")
    left_out = Skipped(steps=(29,), reason="no room")
    write_whole(path, record.opened, [*record.events[1:-1], doubted, restored, left_out])
    section = _section(report_of([path]), "Questioned and superseded readings")
    rows = [(row[1], row[4]) for row in _cells(*_tables(section))]
    assert ("3", "not used: questioned: not as expected") in rows
    assert ("4", "used again: kept: looked twice") in rows
    sentences = [part for part in section.parts if isinstance(part, str)]
    assert sentences == ["doubted.jsonl: 1 step left out: no room"]


@LONG
def test_readings_of_a_posture_stand_in_a_row_each_below_its_axis() -> None:
    (table,) = _tables(_section(report_of([SIMULATED]), f"Readings of {SIMULATED.name}"))
    headings = [str(column.header) for column in table.columns]
    (session,) = solve_files([SIMULATED]).sessions
    readings = {reading.reading: reading for reading in session.all_readings}
    all_numbers: list[int] = []
    for row in _cells(table):
        cells = dict(zip(headings, row, strict=True))
        numbers = [int(number) for number in cells["no."].split(", ")]
        values: dict[str, float] = {readings[k].axis: readings[k].value_mm for k in numbers}
        for axis in "xyz":
            cell = cells[f"{axis}, mm"]
            assert (float(cell) if cell else None) == values.get(axis)
        assert {readings[k].place_words for k in numbers} == {cells["at"]}
        all_numbers += numbers
    assert all_numbers == sorted(readings)
    assert len(table.rows) == len(readings) / 2, "two indicators"


def test_columns_have_room_for_their_numbers_and_share_the_rest() -> None:
    table = new_table("no.", "remark", "other", "value, mm", left_columns=3)
    table.add_row("1", "x" * 300, "short", "+0.1234")
    number, long, short, value = widths_em(table.columns)
    assert sum((number, long, short, value)) == pytest.approx(WIDTH_EM)
    assert value > 0.64 * len("value, mm") > 0.64 * len("+0.1234")
    assert number < short < long
    crowded = new_table("at", *(f"value {k:02d}, mm" for k in range(12)))
    crowded.add_row("leg X at +60 mm", *["+0.1234"] * 12)
    assert min(widths_em(crowded.columns)) > 5.0, "texts keep some room beside many numbers"


@LONG
def test_a_name_stands_in_the_evidence(tmp_path: Path) -> None:
    path = write_session(tmp_path / "play.jsonl", "two-station", 4, "backlash", 0.05)
    evidence, _ = _pictures(_section(report_of([path]), "What is missing from the model"))
    drawn = ElementTree.fromstring(evidence.svg)
    words = {
        "".join(element.itertext()) for element in drawn.iter() if element.tag.endswith("text")
    }
    diagnosis = diagnose_files([path]).diagnosis
    (named,) = (candidate for candidate in diagnosis.candidates if not candidate.reason_rejected)
    assert named.id == "backlash"
    assert {f"backlash ({named.where})", "named", "gap without any of them"} <= words
    assert named.gap_rms_after_mm < 0.2 * diagnosis.gap_before.rms_mm


@LONG
def test_the_decision_rule_stands_with_the_decision() -> None:
    """A tolerance below the bound with the values, and far below what is expected now."""
    result = solve_files([SIMULATED])
    tolerance_mm = 0.9 * result.correction.bound_mm
    report = report_of([SIMULATED], tolerance_mm=tolerance_mm)
    assert report.decision.startswith("UNDECIDED with these values entered, FAIL now")
    judged = judge(result, tolerance_mm)
    assert (judged.after, judged.before) == ("undecided", "fail")
    with_rule = Page(html_of(report)).text
    assert "Decision rule (ISO 14253-1)" in with_rule
    assert "Places of the indicators" in with_rule


def test_without_a_tolerance_nothing_is_judged(experiment: CalibrationReport) -> None:
    assert experiment.decision.startswith("NOT JUDGED")


@LONG
def test_the_same_bytes_twice(experiment: CalibrationReport) -> None:
    html = html_of(experiment)
    assert html == html_of(report_of([EXPERIMENT]))
    assert len(html.encode()) < 2_000_000


def test_nothing_comes_from_elsewhere(experiment: CalibrationReport) -> None:
    page = Page(html_of(experiment))
    names = {name for _, attributes in page.elements for name in attributes}
    assert "script" not in {tag for tag, _ in page.elements}
    assert not names & {"href", "onload", "onclick"}
    assert len(page.sources) == 9 + 3, "one row for each leg"
    for source in page.sources:
        kind, _, data = source.partition(",")
        assert kind == "data:image/svg+xml;base64"
        drawn = ElementTree.fromstring(b64decode(data))
        assert drawn.tag.endswith("svg")
        links = [
            value for element in drawn.iter() for name, value in element.items() if "href" in name
        ]
        assert all(link.startswith("#") for link in links)


def _report_with(words: str) -> CalibrationReport:
    """A report that has these words wherever a text can stand."""
    table = new_table(words, words)
    table.add_row(words, words)
    section = Section(words, [words, table, Picture("<svg></svg>", words)])
    laboratory = Laboratory.model_construct(
        name=words, street=words, city=words, email=words, accreditation=words
    )
    order = CertificateOrder.model_construct(number=words, signed_by=words)
    head = CertificateHead(order, laboratory, None)
    pages = [section], [section, section]
    return CalibrationReport(words, words, [words], [section], words, *pages, head)


PLAIN = [tag for tag, _ in Page(html_of(_report_with("plain"))).elements]


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_words_are_text(words: str) -> None:
    page = Page(html_of(_report_with(words)))
    assert [tag for tag, _ in page.elements] == PLAIN
    assert not HIDDEN.search(page.text)


@settings(max_examples=60)
@given(st.text(min_size=1, max_size=60) | st.text("<>&\"'{}%$\\=\n\x1b\u202e;()", min_size=1))
def test_any_words_are_text(words: str) -> None:
    page = Page(html_of(_report_with(words)))
    assert [tag for tag, _ in page.elements] == PLAIN
    assert not HIDDEN.search(page.text)


def hostile_session(folder: Path, words: Sequence[str] = HOSTILE) -> Path:
    """A session with words of a stranger wherever its record can hold some."""
    record = read_record(SIMULATED)
    opened, word_cycle = record.opened, cycle(words)
    indicators = tuple(
        instrument.model_copy(
            update={name: next(word_cycle) for name in ("profile", "serial_number", "certificate")}
        )
        for instrument in opened.instruments
    )
    machine = opened.machine.model_copy(
        update={"name": next(word_cycle), "adjusted": next(word_cycle)}
    )
    named = {name: next(word_cycle) for name in ("operator", "program")}
    fields = {"machine": machine, "instruments": indicators, "remarks": tuple(words), **named}
    events: list[Line] = list(record.events[1:-1])
    events += [Noted(text=word) for word in words]
    events += [Superseded(readings=(k,), reason=word) for k, word in enumerate(words, start=1)]
    events += [Restored(readings=(k,), reason=word) for k, word in enumerate(words, start=1)]
    path = folder / "a<b>&'.jsonl"
    write_whole(path, opened.model_copy(update=fields), events)
    return path


@LONG
def test_names_of_a_hostile_record_are_text(tmp_path: Path) -> None:
    page = Page(html_of(report_of([hostile_session(tmp_path)])))
    assert {"script", "svg"}.isdisjoint(tag for tag, _ in page.elements)
    assert {names for tag, names in page.elements if tag == "img"} == {("alt", "src")}
    assert not HIDDEN.search(page.text)
    for words in (*HOSTILE, "a<b>&'.jsonl"):
        assert " ".join(printable(words).split()) in page.text


@LONG
def test_the_figures_of_a_plate_can_be_read(tmp_path: Path) -> None:
    """Names of positions stand upright, and the residuals of the positions beside each other."""
    path = tmp_path / "plate.jsonl"
    run = glidecal("simulate", "--machine", "linear-delta", "--seed", "1", "-o", path)
    assert run.status == 0, run.err
    differences, *_ = _pictures(_section(report_of([path]), "Differences"))
    names = solve_files([path]).solution.differences.names
    texts = [
        label for label in ElementTree.fromstring(differences.svg).iter() if label.text in names
    ]
    assert len(texts) == 18
    assert all("rotate(-90" in label.get("transform", "") for label in texts)
    cells = diagnose_files([path]).diagnosis.residuals.cells
    _, before = residuals_before_and_after(cells).series
    assert len(set(before.x)) == len(before.x) == len(cells)


@LONG
def test_with_a_later_session_it_decides(tmp_path: Path) -> None:
    after = tmp_path / "after.jsonl"
    offsets = ",".join(f"{mm}" for mm in solve_files([SIMULATED]).joint_offsets_mm)
    machine = tmp_path / "m.toml"
    machine.write_text(
        f'schema = "glidecal.machine/1"\nname = "orthoglide"\nentered_offsets_mm = [{offsets}]\n'
    )
    run = glidecal("simulate", "--machine", machine, "--seed", "1", "-o", after)
    assert run.status == 0, run.err
    report = report_of([SIMULATED], after=after, tolerance_mm=5.0)
    assert report.decision.startswith("PASS")
    assert [s.heading for s in report.sections].count(
        "Measured again, with the offsets entered"
    ) == 1
    page = Page(html_of(report)).text
    assert "Predicted with the values entered: the tool is off by at most" in page
    assert "tool error, r.m.s. (95 %) before, mm" in " ".join(page.split())
    words = " ".join(page.split())
    assert not [words[at.start() - 60 : at.end() + 40] for at in re.finditer(r"\bnow\b", words)]


@LONG
@pytest.mark.filterwarnings("ignore:HarfBuzz-Subset:DeprecationWarning")  # of the system
def test_pdf_is_the_same_twice_and_drawn(experiment: CalibrationReport) -> None:
    html = html_of(replace(experiment, sections=experiment.sections[:2]))
    assert "data:image/svg+xml" in html
    try:
        printed = pdf_of(html)
    except UsageError as problem:
        pytest.skip(str(problem))
    assert printed == pdf_of(html)
    assert printed.startswith(b"%PDF-")
    assert b"/Image" not in printed, "figures are lines and letters, no pixels"


@LONG
def test_the_command(tmp_path: Path) -> None:
    target = tmp_path / "report.html"
    run = glidecal("report", EXPERIMENT, "-o", target)
    assert (run.status, run.out) == (0, "")
    assert "Calibration report" in target.read_text(encoding="utf-8")
    again = glidecal("report", EXPERIMENT, "-o", target)
    assert again.status != 0
    assert "--force" in again.err
    refusal = glidecal("report", EXPERIMENT, "-o", tmp_path / "report.doc")
    assert refusal.status == 2
    assert ".html, .pdf, .xml" in refusal.err


def test_without_the_extra_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def none(name: str, *arguments: object) -> ModuleType:
        if name.startswith("matplotlib"):
            raise ModuleNotFoundError(f"No module named {name!r}", name="matplotlib")
        return real(name, *arguments)  # type: ignore[arg-type]  # handed on as it came

    monkeypatch.setattr(builtins, "__import__", none)
    with (
        pytest.raises(UsageError, match=r"no package matplotlib.*-m pip install .*matplotlib>="),
        extra("glidecal report", "report"),
    ):
        import matplotlib.figure  # noqa: F401  (asked for once more)


def test_the_names_of_six_series_are_within_the_picture() -> None:
    """Before: the last of "leg Z along Y" was cut off."""
    legs = [f"leg {leg} along {axis}" for leg in "XYZ" for axis in "XYZ" if leg != axis]
    for names in (legs, [f"{name}, station 0.75" for name in legs]):
        series = tuple(Series(name, (0.0, 1.0), (0.0, 1.0)) for name in names)
        root = ElementTree.fromstring(svg_of(Chart("residuals", "minutes", "µm", series)))
        starts = {text.text: float(text.get("x", "nan")) for text in root.iter() if text.text}
        right_pt = float(root.get("viewBox", "").split()[2])
        for name in names:
            assert starts[name] + TextPath((0, 0), name, size=8).get_extents().width < right_pt
