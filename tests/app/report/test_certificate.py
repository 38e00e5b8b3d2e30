"""The two pages that are signed: what stands on which, whatever a record says; and bad input."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from pathlib import Path

import pytest

from app.evaluating.diagnosis import diagnose_files
from app.evaluating.solution import solve_files
from app.report.certificate import calibration_of, read_head
from app.report.pages.report import html_of, pdf_of
from app.report.text.tables import signed, uncertain
from calib.errors import RecordError, UsageError
from calib.posterior.cells import SessionCase
from calib.posterior.models import Posterior
from calib.posterior.posterior import posterior
from calib.tripod.effects.effect import Effect
from protocols.journal import write_whole
from protocols.record import read_record
from protocols.session import Noted, Superseded
from tests.app.cli import glidecal, refused
from tests.app.report.certificates import LABORATORY, ORDER, laboratory, report_of
from tests.conftest import LONG, SAMPLES, first_quick

SIXTY = SAMPLES / "simulated_zero-max-min.jsonl"
MANY = SAMPLES / "simulated_two-station.jsonl"
WIDE = "W" * 180

pytestmark = pytest.mark.filterwarnings("ignore:HarfBuzz-Subset:DeprecationWarning")


def printed_pages(html: str) -> list[str]:
    """The text of each page of the PDF."""
    pdfium = pytest.importorskip("pypdfium2")
    try:
        content = pdf_of(html)
    except UsageError as problem:
        pytest.skip(str(problem))
    return page_texts(pdfium.PdfDocument(content))


def page_texts(document: Sequence[object]) -> list[str]:
    return [
        " ".join(page.get_textpage().get_text_bounded().split())  # type: ignore[attr-defined]
        for page in document
    ]


def check_pages(pages: Sequence[str], identification: str) -> None:
    """Two pages to sign, then the annex; each says which document it belongs to."""
    first, second, third, *_ = pages
    for number, page in enumerate(pages, start=1):
        assert f"Page {number} of {len(pages)}" in page
        assert identification in page
    assert "Traceability" in first
    assert "Result" in first
    assert "Uncertainty budget" not in first + second, "no second U beside that of the values"
    assert "Uncertainty" in second
    assert any("Uncertainty budget of these parameters" in page for page in pages[2:])
    assert "Limits of this result" in second
    assert "Signature" in second
    assert "Annex What was measured" in third
    assert "Signature" not in " ".join([first, third, *pages[3:]])


@pytest.mark.parametrize("session", first_quick([SIXTY, MANY]))
def test_a_certificate_has_two_pages_and_an_annex(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    head = read_head(laboratory(tmp_path, monkeypatch))
    html = html_of(report_of([session], head=head, tolerance_mm=0.1))
    pages = printed_pages(html)
    check_pages(pages, "Certificate 2026-0042")
    result = solve_files([session])
    half_widths_mm = result.corrections.uncertainties_mm()[1]
    for leg, value_mm, half_mm in zip("xyz", result.joint_offsets_mm, half_widths_mm, strict=True):
        assert f"d_rho_{leg} {signed(value_mm, 4)} mm {uncertain(half_mm, 4)}" in pages[0]
    for words in ("OG-0007", "Accreditation D-K-00000", "hall 3", "2026-11-25", "SIMULATED"):
        assert words in pages[0]
    assert "customer <script>alert(1)</script> & Co. address Sample Town" in pages[0]
    assert "<script>" not in html
    assert "data:image/png;base64," in html
    assert "Name: A. Example" in pages[1]


@LONG
def test_two_pages_are_enough_for_the_longest_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three sessions with names, notes and doubts as long as they may be, and one after them."""
    order = ORDER.replace("A. Example", WIDE).replace("hall 3", WIDE).replace("Maker", WIDE)
    shop = LABORATORY.replace("Long Street 12", WIDE).replace("Brunswick", WIDE)
    head = read_head(laboratory(tmp_path, monkeypatch, shop, order))
    record = read_record(SIXTY)
    machine = record.opened.machine.model_copy(update={"name": WIDE})
    fields = {"serial_number": WIDE, "certificate_date": date(2026, 1, 1)}
    paths = []
    for number in range(4):
        instruments = tuple(
            indicator.model_copy(update={**fields, "certificate": f"{number}{axis}{WIDE}"})
            for axis, indicator in zip("yz", record.opened.instruments, strict=True)
        )
        opened = record.opened.model_copy(
            update={
                "machine": machine,
                "operator": WIDE,
                "instruments": instruments,
                "temperature_c": 20.0 + number,
            }
        )
        doubt = Superseded(readings=(3 + number,), reason=WIDE)
        paths.append(tmp_path / f"{'session' * 20}{number}.jsonl")
        write_whole(paths[-1], opened, [*record.events[1:-1], Noted(text=WIDE), doubt])
    report = report_of(paths[:3], after=paths[3], head=head, tolerance_mm=0.1)
    check_pages(printed_pages(html_of(report)), "Certificate 2026-0042")


@LONG
def test_without_an_order_pages_are_of_the_record() -> None:
    report = report_of([SIXTY])
    assert report.identification == f"Record {read_record(SIXTY).digest[:12]}"
    html = html_of(report)
    assert re.search(r"<h1>Calibration report</h1>", html)
    assert r'content: "Record\000020' in html


def test_a_report_works_out_one_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solution and diagnosis share it; what is diagnosed is what a diagnosis alone says."""
    posteriors: list[Posterior] = []

    def counted(cases: Sequence[SessionCase], effects: Sequence[Effect] | None) -> Posterior:
        posteriors.append(posterior(cases, effects))
        return posteriors[-1]

    monkeypatch.setattr("app.evaluating.correction.posterior", counted)
    calibration = calibration_of([SIXTY])
    shared, alone = calibration.diagnosed, diagnose_files([SIXTY])
    assert shared.corrections.posterior is calibration.result.corrections.posterior
    assert len(posteriors) == 2, "of the report, and of the diagnosis beside it"
    assert shared.diagnosis.verdict == alone.diagnosis.verdict
    assert shared.diagnosis.sentence == alone.diagnosis.sentence
    assert shared.tool.now_mm == pytest.approx(alone.tool.now_mm)


@LONG
def test_only_sessions_of_certified_indicators_are_traceable(tmp_path: Path) -> None:
    record = read_record(SIXTY)
    instruments = tuple(
        indicator.model_copy(update={"certificate": f"K-{k}", "serial_number": f"47-{k}"})
        for k, indicator in enumerate(record.opened.instruments)
    )
    path = tmp_path / "known.jsonl"
    opened = record.opened.model_copy(update={"instruments": instruments})
    write_whole(path, opened, list(record.events[1:-1]))
    (_, known_section, _), (_, unknown, _) = (report_of([p]).first_page for p in (path, SIXTY))
    assert known_section.parts[-1] == (
        "Lengths are traceable to the SI through these certificates of the indicators."
    )
    assert str(unknown.parts[-1]).startswith("Traceability to the SI is not shown")


@LONG
def test_a_table_is_traceable_through_the_instruments_of_the_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table of readings is no instrument; its days, both of them, are on the first page."""
    before, after = tmp_path / "before.jsonl", tmp_path / "after.jsonl"
    for path, day, number in ((before, "2026-11-01", 2), (after, "2026-11-02", 1)):
        table = SAMPLES / "tables" / f"experiment_{number}_six.csv"
        run = glidecal("import", table, "-o", path, "--measured-on", day)
        assert run.status == 0, run.err
    indicator = '[[instrument]]\nname = "dial"\ncertificate = "K-88"\n'
    order = laboratory(tmp_path, monkeypatch, order=f"{ORDER}\n{indicator}")
    calibration = calibration_of([before], later_path=after, head=read_head(order))
    assert [instrument.name for instrument in calibration.instruments] == ["dial"]
    html = html_of(report_of([before], after=after, head=read_head(order)))
    assert "Lengths are traceable to the SI" in html
    assert re.search(r"2026-11-01, 2026-11-02\s*<", html)
    unnamed = calibration_of([before], head=None)
    assert [instrument.name for instrument in unnamed.instruments] == ["table"]


@LONG
def test_several_sessions_are_verified_by_the_values_that_were_entered(tmp_path: Path) -> None:
    """One number on both pages: that of all sessions, not of the last one alone."""
    paths = [tmp_path / f"{seed}.jsonl" for seed in (1, 2, 3)]
    for seed, path in enumerate(paths, start=1):
        run = glidecal("simulate", "-o", path, "--seed", f"{seed}", "--scatter", "0.02")
        assert run.status == 0, run.err
    calibration = calibration_of(paths[:2], later_path=paths[2])
    assert calibration.verification is not None
    stated = [offset.before_mm for offset in calibration.verification.offsets]
    assert stated == pytest.approx(calibration.result.joint_offsets_mm, abs=1e-12)


@pytest.mark.parametrize(
    ("kind", "content", "words"),
    [
        ("text", b"not a picture", "no picture that can be read"),
        ("large", b"\x89PNG" + bytes(1_000_001), "more than 1,000,000 bytes"),
        ("missing", None, "No such file"),
    ],
)
def test_a_bad_logo_is_one_sentence(
    kind: str,
    content: bytes | None,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order = laboratory(tmp_path, monkeypatch)
    (tmp_path / "logo.png").unlink()
    if content is not None:
        (tmp_path / "logo.png").write_bytes(content)
    with pytest.raises(RecordError, match=words):
        read_head(order)


@pytest.mark.parametrize(
    ("order", "settings", "status", "words"),
    [
        (ORDER.replace('number = "2026-0042"', ""), LABORATORY, 3, "number: missing"),
        (ORDER.replace("2026-0042", "  "), LABORATORY, 3, "number: a text, not nothing"),
        (ORDER.replace("[customer]", "[client]"), LABORATORY, 3, "customer: missing"),
        (ORDER, "", 2, "no laboratory in the settings file"),
        (ORDER, LABORATORY.replace('"DE"', '"Germany"'), 3, "line 6, laboratory.country"),
    ],
)
def test_what_is_missing_is_one_sentence(
    order: str,
    settings: str,
    status: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = laboratory(tmp_path, monkeypatch, settings, order)
    target = tmp_path / "c.html"
    assert words in refused(status, "report", SIXTY, "--certificate", path, "-o", target)
    assert not target.exists()


@LONG
def test_a_number_is_of_one_certificate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = laboratory(tmp_path, monkeypatch)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    for name in ("a.html", "a.xml"):
        run = glidecal("report", SIXTY, "--certificate", path, "-o", tmp_path / name)
        assert run.status == 0, run.err
    stricter = ("report", SIXTY, "--certificate", path, "--tolerance", "0.001")
    assert "found tolerance 0.001 mm in place of " in refused(
        2, *stricter, "-o", tmp_path / "d.xml"
    )
    again = ("report", MANY, "--certificate", path, "-o", tmp_path / "b.html")
    refusal = refused(2, *again)
    assert "a number that another certificate has" in refusal
    digest = read_record(SIXTY).session.digest
    assert f"begin with {digest[:12]}; {next(tmp_path.rglob('certificates.json'))} " in refusal
    assert not any((tmp_path / name).exists() for name in ("b.html", "d.xml"))
