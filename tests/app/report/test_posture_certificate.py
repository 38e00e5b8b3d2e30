"""Certificates of sessions of postures: valid, the truth within what they state, on paper too."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from app.report.certificate import read_head
from app.report.dcc.document import certificate_xml
from app.report.pages.hexaslide import source_of_postures
from app.report.pages.report import html_of
from calib.hexaslide.geometry import Geometry
from protocols.hexaslide import HexaSlideMachine, load_hexaslide
from protocols.hexaslide_session import read_postures, simulated_truth
from protocols.machine_files import MACHINES
from tests.app.cli import glidecal, refused
from tests.app.posture_sessions import TOLERANCE_MM, before_and_after, posture_session
from tests.app.report.certificates import LABORATORY, ORDER, laboratory
from tests.app.report.test_certificate import printed_pages
from tests.app.report.test_dcc import NAMES, faults_of, values_of
from tests.conftest import LONG, first_quick

__all__ = ["faults_of"]  # the fixture

TRACKER = """
[[instrument]]
name = "laser tracker"
serial_number = "T-17"
certificate = "K-2026-88"
certificate_date = 2026-02-03
"""


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return before_and_after(tmp_path_factory.mktemp("pair"))


@pytest.fixture
def order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return laboratory(tmp_path, monkeypatch, order=ORDER + TRACKER)


def written(order: Path, session: Path, after: Path | None = None) -> str:
    source = source_of_postures(session, after, None, read_head(order))
    return certificate_xml(source.certified, source.results())


def stewart() -> HexaSlideMachine:
    machine = load_hexaslide(MACHINES / "gough-stewart.toml")
    return machine.model_copy(update={"platform_tolerance_mm": TOLERANCE_MM})


@pytest.mark.parametrize(
    "procedure", first_quick(["pose-inverse", "constraint-link", "link-indicator"])
)
def test_every_procedure_is_valid(
    procedure: str, order: Path, tmp_path: Path, faults_of: Callable[[str], list[str]]
) -> None:
    session = posture_session(tmp_path / "s.jsonl", procedure, 5)
    assert faults_of(written(order, session)) == []


def test_telescopic_legs_are_valid(
    order: Path, tmp_path: Path, faults_of: Callable[[str], list[str]]
) -> None:
    session = posture_session(tmp_path / "s.jsonl", "pose-forward", 5, stewart(), random=16)
    xml = written(order, session)
    assert faults_of(xml) == []
    assert "rail z" not in xml


def lengths_mm(geometry: Geometry) -> dict[str, float]:
    """Of a machine, by the names that the certificate has, straight from its points."""
    joints, starts = 1000.0 * geometry.platform, 1000.0 * geometry.base
    lengths = {
        f"B{i + 1}-B{j + 1}": float(np.linalg.norm(joints[i] - joints[j]))
        for i in range(6)
        for j in range(i + 1, 6)
    }
    lengths |= {f"A1-A{k + 1}": float(np.linalg.norm(starts[k] - starts[0])) for k in range(1, 6)}
    return lengths | {f"l{k + 1}": 1000.0 * float(geometry.links[k]) for k in range(6)}


def test_a_verified_one_holds_the_truth(
    pair: tuple[Path, Path], order: Path, faults_of: Callable[[str], list[str]]
) -> None:
    """Of 26 lengths that no frame changes about 25 are expected within ± U."""
    before, after = pair
    xml = written(order, before, after)
    assert faults_of(xml) == []
    root = ElementTree.fromstring(xml)
    decisions = root.findall(".//dcc:metaData/dcc:conformity", NAMES)
    assert [decision.text for decision in decisions] == ["fail", "pass"]
    true = lengths_mm(simulated_truth(read_postures(before)[0]).whole().geometry)
    within = 0
    for real in root.findall(".//dcc:result//si:real", NAMES):
        name = real.findtext("si:label", "", NAMES)
        if name in true:
            value, expanded, factor = values_of(real, "value", "uncertainty", "coverageFactor")
            within += abs(value - true.pop(name)) <= expanded
            assert 1.0 < factor < 2.3  # of a mixture of models
            assert 0.0 < expanded < 1.0
    assert true == {}
    assert within >= 22


def test_the_values_are_those_of_the_machine_file(
    pair: tuple[Path, Path], order: Path, tmp_path: Path
) -> None:
    before, _ = pair
    target = tmp_path / "m.toml"
    assert glidecal("export", before, "--format", "model", "-o", target).status == 0
    root = ElementTree.fromstring(written(order, before))
    stated = {
        real.findtext("si:label", "", NAMES): values_of(real, "value")[0]
        for real in root.findall(".//dcc:result//si:real", NAMES)
    }
    for number, chain in enumerate(load_hexaslide(target).chain, start=1):
        assert stated[f"chain {number}: link_mm"] == pytest.approx(chain.link_mm, abs=1e-6)
        assert chain.rail is not None
        for axis, start, joint, rail in zip(
            "xyz", chain.start_mm, chain.joint_mm, chain.rail, strict=True
        ):
            assert stated[f"chain {number}: start_mm {axis}"] == pytest.approx(start, abs=1e-6)
            assert stated[f"chain {number}: joint_mm {axis}"] == pytest.approx(joint, abs=1e-6)
            assert stated[f"chain {number}: rail {axis}"] == pytest.approx(rail, abs=1e-9)


@LONG
def test_the_certificate_on_paper(pair: tuple[Path, Path], order: Path, tmp_path: Path) -> None:
    """Head, customer and tracker are on it; both records are; strangers' words are text."""
    before, after = pair
    target = tmp_path / "c.html"
    arguments = ("report", before, "--after", after, "--certificate", order)
    assert glidecal(*arguments, "-o", target).status == 0
    html = target.read_text("utf-8")
    assert "<script" not in html
    _, second, third, *_ = printed_pages(html)
    assert "Signature" in second
    assert "Annex What was measured" in third
    page = " ".join(re.sub(r"<[^>]+>", " ", html).split())
    assert "Calibration certificate 2026-0042" in page
    for words in ("OG-0007", "Sample Town", "laser tracker T-17 K-2026-88 2026-02-03"):
        assert words in page
    assert "Lengths are traceable to the SI through these certificates of the instruments." in page
    for session in pair:
        assert read_postures(session)[1].digest in page
        assert f"Readings of {session.name}" in page
    # the same records in another format; other records are refused
    assert glidecal(*arguments, "-o", tmp_path / "c.xml").status == 0
    arguments_of_after = ("report", after, "--certificate", order, "-o", tmp_path / "other.xml")
    assert "a number that another certificate has" in refused(2, *arguments_of_after)


def test_what_a_certificate_as_xml_needs(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, _ = pair
    target = tmp_path / "c.xml"
    assert "no number, customer and laboratory" in refused(2, "report", before, "-o", target)
    order = laboratory(tmp_path, monkeypatch, LABORATORY.replace('country = "DE"', ""))
    arguments = ("report", before, "--certificate", order, "-o", target)
    assert "no country of the laboratory" in refused(2, *arguments)
    assert not target.exists()


def test_without_the_certificate_of_an_instrument_nothing_is_traceable(
    pair: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, _ = pair
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    tracker = TRACKER.replace('certificate = "K-2026-88"\n', "")
    order = laboratory(tmp_path, monkeypatch, order=ORDER + tracker)
    source = source_of_postures(before, head=read_head(order))
    words = "Traceability to the SI is not shown: not every instrument has a certificate."
    xml = certificate_xml(source.certified, source.results())
    assert words in html_of(source.page())
    assert words in xml
    assert "NOT IDENTIFIABLE, left as the machine file has it" in xml
