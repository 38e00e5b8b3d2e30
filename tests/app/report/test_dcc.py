"""The digital certificate: valid, the report's numbers, read and verified by others' libraries."""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from app.evaluating.solution import solve_files
from app.report.certificate import calibration_of, read_head
from app.report.dcc.document import UNITS, certificate_xml
from app.report.dcc.legs import results_of
from app.report.pages.contents import report_from
from app.report.pages.report import html_of
from protocols.journal import write_whole
from protocols.record import read_record
from protocols.session import Line
from tests.app.cli import glidecal, refused
from tests.app.report.certificates import LABORATORY, laboratory, report_of
from tests.app.report.test_pages import HOSTILE, hostile_session
from tests.conftest import LONG, ROOT, SAMPLES

SCHEMAS = ROOT.parent / "shared" / "data" / "dcc"
SIMULATED = SAMPLES / "simulated_zero-max-min.jsonl"

NAMES = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}


@pytest.fixture(scope="module")
def faults_of() -> Callable[[str], list[str]]:
    """What the schemas of PTB object to."""
    xmlschema = pytest.importorskip("xmlschema")
    folder = Path(os.environ.get("GLIDECAL_DCC_SCHEMAS", SCHEMAS))
    if not (folder / "dcc-3.2.1.xsd").is_file():
        pytest.skip("no schemas of the DCC beside the repository")
    schema = xmlschema.XMLSchema(
        str(folder / "dcc-3.2.1.xsd"),
        allow="local",
        locations={
            NAMES["si"]: str(folder / "SI_Format-2.1.0.xsd"),
            "http://www.w3.org/2000/09/xmldsig#": str(folder / "xmldsig-core-schema.xsd"),
        },
    )
    return lambda xml: [f"{fault.path}: {fault.reason}" for fault in schema.iter_errors(xml)]


@pytest.fixture
def order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return laboratory(tmp_path, monkeypatch)


def written(order: Path, session: Path, after: Path | None = None) -> str:
    """The certificate of a session with a tolerance."""
    head = read_head(order)
    calibration = calibration_of([session], later_path=after, head=head, tolerance_mm=0.1)
    return certificate_xml(calibration, results_of(calibration))


def later_session(folder: Path) -> Path:
    """The machine of the sample with its offsets entered, simulated again."""
    path, machine = folder / "after.jsonl", folder / "machine.toml"
    offsets = list(solve_files([SIMULATED]).joint_offsets_mm)
    machine.write_text(
        f'schema = "glidecal.machine/1"\nname = "orthoglide"\nentered_offsets_mm = {offsets}\n'
    )
    run = glidecal("simulate", "--machine", machine, "--seed", "1", "-o", path)
    assert run.status == 0, run.err
    return path


KINDS = [
    *("experiment_2_twelve", "simulated_plane", "simulated_two-station"),
    *(f"every_schema/6/{name}" for name in ("contacts", "measured", "moved", "plane", "plate")),
]


@pytest.mark.parametrize("name", KINDS)
def test_sessions_of_every_kind_are_valid(
    name: str, order: Path, faults_of: Callable[[str], list[str]]
) -> None:
    assert faults_of(written(order, SAMPLES / f"{name}.jsonl")) == []


def test_a_verified_one_is_valid(
    order: Path, tmp_path: Path, faults_of: Callable[[str], list[str]]
) -> None:
    xml = written(order, SIMULATED, later_session(tmp_path))
    assert faults_of(xml) == []
    root = ElementTree.fromstring(xml)
    decisions = root.findall(".//dcc:metaData/dcc:conformity", NAMES)
    assert [decision.text for decision in decisions] == ["fail", "pass", "pass"]


def with_tolerance(source: Path, target: Path, tolerance_mm: float | None) -> Path:
    """The same readings of a machine whose file states this tolerance."""
    record = read_record(source)
    machine = record.opened.machine.model_copy(update={"tool_tolerance_mm": tolerance_mm})
    opened = record.opened.model_copy(update={"machine": machine})
    write_whole(target, opened, list(record.events[1:-1]))
    return target


@LONG
@pytest.mark.parametrize(
    ("earlier_mm", "later_mm", "judged_mm"),
    [(0.05, 0.001, 0.001), (None, 0.5, 0.5), (0.5, None, 0.5)],
)
def test_every_decision_is_against_the_tolerance_beside_it(
    earlier_mm: float | None, later_mm: float | None, judged_mm: float, order: Path, tmp_path: Path
) -> None:
    before = with_tolerance(SIMULATED, tmp_path / "before.jsonl", earlier_mm)
    after = with_tolerance(later_session(tmp_path), tmp_path / "later.jsonl", later_mm)
    calibration = calibration_of([before], later_path=after, head=read_head(order))
    root = ElementTree.fromstring(certificate_xml(calibration, results_of(calibration)))
    tolerances = root.findall(".//dcc:measurementMetaData//si:value", NAMES)
    assert [float(value.text or "nan") for value in tolerances] == [judged_mm] * 3
    decided = root.findall(".//dcc:metaData/dcc:declaration/dcc:content", NAMES)
    assert decided[-1].text == ("pass" if judged_mm == 0.5 else "undecided")
    assert f"Tolerance: {judged_mm:g} mm" in calibration.decision
    assert f"tolerance {judged_mm:g} mm" in calibration.judged_words


@LONG
def test_the_last_day_is_that_of_the_last_reading(order: Path, tmp_path: Path) -> None:
    """Before: both days were that of the session's begin."""
    record, path = read_record(SIMULATED), tmp_path / "overnight.jsonl"
    began = datetime(2026, 11, 20, 22, 0, tzinfo=UTC)
    lines = [line for line in record.events[1:-1] if line.event != "closed"]
    dated: list[Line] = [
        line.model_copy(update={"at": began + timedelta(hours=4.0 * k / len(lines))})
        for k, line in enumerate(lines, start=1)
    ]
    write_whole(path, record.opened.model_copy(update={"at": began}), dated)
    root = ElementTree.fromstring(written(order, path))
    dates = [root.find(f".//dcc:{end}PerformanceDate", NAMES) for end in ("begin", "end")]
    assert [day.text for day in dates if day is not None] == ["2026-11-20", "2026-11-21"]
    html = html_of(report_of([path], head=read_head(order)))
    assert "2026-11-20 to 2026-11-21" in " ".join(html.split())


@LONG
def test_another_serial_number_in_the_record_is_shown(order: Path, tmp_path: Path) -> None:
    """The order may mend a number, or be that of another machine: who signs must see both."""
    record = read_record(SIMULATED)
    path = tmp_path / "numbered.jsonl"
    for number, words in (("OG-1", ["OG-0007", "OG-1"]), ("OG-0007", ["OG-0007"])):
        machine = record.opened.machine.model_copy(update={"serial_number": number})
        opened = record.opened.model_copy(update={"machine": machine})
        write_whole(path, opened, list(record.events[1:-1]))
        root = ElementTree.fromstring(written(order, path))
        stated = root.findall(".//dcc:item/dcc:identifications/dcc:identification/dcc:value", NAMES)
        assert [value.text for value in stated][1:] == words
        html = html_of(report_of([path], head=read_head(order)))
        assert ("serial number in the record" in html) == (number == "OG-1")
        path.unlink()


@LONG
def test_words_of_strangers_are_text(
    order: Path, tmp_path: Path, faults_of: Callable[[str], list[str]]
) -> None:
    for k, words in enumerate(HOSTILE):
        folder = tmp_path / f"{k}"
        folder.mkdir()
        xml = written(order, hostile_session(folder, [words]))
        assert faults_of(xml) == []
        assert "<script" not in xml


def test_what_is_blank_is_left_out(
    order: Path, tmp_path: Path, faults_of: Callable[[str], list[str]]
) -> None:
    """The schema allows no empty text and none that begins with a space."""
    record = read_record(SIMULATED)
    instruments = tuple(
        indicator.model_copy(update={"profile": " ", "serial_number": " 1 ", "certificate": ""})
        for indicator in record.opened.instruments
    )
    machine = record.opened.machine.model_copy(update={"name": " \u2028 "})
    opened = record.opened.model_copy(
        update={"machine": machine, "instruments": instruments, "temperature_c": -0.5}
    )
    path = tmp_path / "blank.jsonl"
    write_whole(path, opened, list(record.events[1:-1]))
    assert faults_of(written(order, path)) == []


@pytest.fixture(scope="module")
def dcc() -> Iterator[ModuleType]:
    """The library pydcc.

    Its oscrypto takes no version of OpenSSL whose last number has two digits, such as 3.0.17: as it
    is imported, its pattern is widened. Its validator gets schemas from the web, so it has none.
    """
    real = re.search

    def search(pattern: Any, *arguments: Any) -> Any:  # noqa: ANN401 (as of the re module)
        if isinstance(pattern, str):
            pattern = pattern.replace(r"\d\.\d\.\d[a-z]*", r"\d+\.\d+\.\d+[a-z]*")
        return real(pattern, *arguments)

    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        patch.setattr(re, "search", search)
        library = pytest.importorskip("dcc", reason="needs pydcc")
        patch.setattr(library.dcc, "DCCXMLValidator", lambda: None)
        yield library


def read_by_others(dcc: ModuleType, xml: bytes) -> dict[str, dict[str, Any]]:
    """Quantities by their names, as pydcc reads them."""
    certificate = dcc.DCC(byte_array=xml)
    assert certificate.is_loaded()
    assert certificate.uid() == "2026-0042"
    assert certificate.mandatory_language() == "en"
    assert certificate.calibration_laboratory_name() == "Laboratory <b>& Sons</b>"
    measured = read_record(SIMULATED).opened.at
    assert certificate.calibration_date().date() == measured.date()
    results = certificate.get_calibration_results("name")
    return {name.strip(): content["real"] for name, content in results}


def number(real: dict[str, Any], *path: str) -> float:
    entry: Any = real
    for name in path:
        entry = entry[name]
    return float(entry)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_another_library_reads_the_numbers_of_the_report(dcc: ModuleType, order: Path) -> None:
    head = "Calibration of a parallel kinematic machine"
    real = read_by_others(dcc, written(order, SIMULATED).encode())
    result = solve_files([SIMULATED])
    half_widths_mm = result.corrections.uncertainties_mm()[1]
    for leg, value_mm, half_mm in zip("xyz", result.joint_offsets_mm, half_widths_mm, strict=True):
        offset = real[f"{head} Values to enter d_rho_{leg}"]
        assert number(offset, "value") == value_mm
        if "expandedUnc" in offset:
            expanded = number(offset, "expandedUnc", "uncertainty")
            assert number(offset, "expandedUnc", "coverageFactor") >= 1.0
            assert number(offset, "expandedUnc", "coverageProbability") == 0.95
        else:
            ends = [number(offset, "coverageInterval", f"interval{end}") for end in ("Min", "Max")]
            assert sum(ends) / 2.0 == pytest.approx(value_mm)
            expanded = (ends[1] - ends[0]) / 2.0
        assert expanded == pytest.approx(half_mm, rel=1e-9)
    tool = f"{head} Error of the tool over the workspace touched off: a shift is free"
    assert number(real[f"{tool}, as measured"], "value") == result.correction.now_mm
    then = real[f"{tool}, with the values entered, predicted"]
    assert number(then, "value") == result.correction.bound_mm


def statements(xml: str) -> list[tuple[str, str]]:
    """Name and text of each statement."""
    nodes = ElementTree.fromstring(xml).findall(".//dcc:statement", NAMES)
    return [
        ("".join(name.itertext()).strip(), "".join(text.itertext()).strip()) for name, text in nodes
    ]


def test_the_limits_of_the_paper_are_in_the_xml(order: Path) -> None:
    """Before: the XML had no warning, and said less of traceability than the page."""
    path, head = SAMPLES / "experiment_2_twelve.jsonl", read_head(order)
    calibration = calibration_of([path], head=head)
    stated = statements(certificate_xml(calibration, results_of(calibration)))
    limits = [" ".join(text.split()) for text in (*calibration.warnings, *calibration.limits)]
    assert any(text.startswith("WARNING: the residual is") for text in limits)
    assert [text for name, text in stated if name == "Limit of this result"] == limits
    [traceability] = [text for name, text in stated if name == "Metrological traceability"]
    assert traceability in html_of(report_of([path], head=head))


def test_what_a_model_adds_is_on_the_page_and_in_the_xml(order: Path, tmp_path: Path) -> None:
    """Before: the XML had no word of it, beside a verdict that nothing is missing."""
    model, head = tmp_path / "model.json", read_head(order)
    play = '{"id": "backlash", "where": "x", "parameters": {"play": {"value": 0.02, "unit": "mm"}}}'
    model.write_text(f'{{"schema": "glidecal.model/1", "effects": [{play}]}}', encoding="utf-8")
    calibration = calibration_of([SIMULATED], model=model, head=head)
    words = "All figures are with what the model file adds: backlash (x)."
    assert ("Limit of this result", words) in statements(
        certificate_xml(calibration, results_of(calibration))
    )
    assert words in html_of(report_from(calibration))


def test_uncertainties_are_expanded_or_intervals(order: Path) -> None:
    """A mixture of models may have no coverage factor that D-SI takes: U below u, 95 %."""
    root = ElementTree.fromstring(written(order, SAMPLES / "simulated_two-station.jsonl"))
    result = solve_files([SAMPLES / "simulated_two-station.jsonl"])
    standard_mm, expanded_mm = result.corrections.uncertainties_mm()
    view = result.solution
    every_mm = view.expanded_with_tolerances_mm  # as on paper: of the noise alone it was a tenth
    parts_mm = np.sqrt(every_mm**2 - view.expanded_mm**2) / 1.959964
    standards_mm = np.hypot(view.uncertainty_mm, parts_mm)
    stated = [
        *zip(standard_mm.tolist(), expanded_mm.tolist(), strict=True),
        *zip(standards_mm.tolist(), every_mm.tolist(), strict=True),
    ]
    reals = [
        real
        for real in root.findall(".//dcc:result//si:real", NAMES)
        if real.find(".//si:coverageProbability", NAMES) is not None
    ]
    assert len(reals) == len(stated)
    kinds = set()
    for real, (u, wide) in zip(reals, stated, strict=True):
        (value,) = values_of(real, "value")
        kinds.add(wide >= u)
        if wide >= u:
            numbers = values_of(real, "uncertainty", "coverageFactor", "coverageProbability")
            assert numbers == pytest.approx([wide, wide / u, 0.95])
        else:
            numbers = values_of(
                real, "standardUnc", "intervalMin", "intervalMax", "coverageProbability"
            )
            assert numbers == pytest.approx([u, value - wide, value + wide, 0.95])
    assert kinds == {True, False}


def values_of(real: ElementTree.Element, *names: str) -> list[float]:
    """Numbers in a quantity of D-SI."""
    return [float(real.findtext(f".//si:{name}", "nan", NAMES)) for name in names]


@pytest.mark.filterwarnings("ignore:The dsi string contains the token:DeprecationWarning")
def test_units_are_of_the_digital_si() -> None:
    dsi = pytest.importorskip("dsi_unit", reason="needs dsiUnits")
    for unit in UNITS.values():
        assert dsi.DsiUnit(unit).valid
        assert dsi.DsiUnit(unit).warnings == []
    metre = dsi.DsiUnit(r"\metre")
    assert metre.get_scale_factor(dsi.DsiUnit(UNITS["mm"])) == pytest.approx(1e-3)


def test_a_certificate_needs_an_order_and_a_country(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "c.xml"
    assert "no number, customer and laboratory" in refused(2, "report", SIMULATED, "-o", target)
    order = laboratory(tmp_path, monkeypatch, LABORATORY.replace('country = "DE"', ""))
    arguments = ("report", SIMULATED, "--certificate", order, "-o", target)
    assert "no country of the laboratory" in refused(2, *arguments)
    assert not target.exists()


# signed


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with keys of a laboratory: RSA, elliptic curve, with a password, too old."""
    pytest.importorskip("signxml", reason="needs the extra sign")
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec, rsa
    from cryptography.hazmat.primitives.serialization import pkcs12
    from cryptography.x509.oid import NameOID

    folder = tmp_path_factory.mktemp("keys")
    of_rsa = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    of_curve = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "Laboratory")])
    now = datetime.now(UTC)

    def certified(
        key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey, days: int = 30
    ) -> x509.Certificate:
        usage = x509.KeyUsage(*(True, True, *[False] * 7))
        return (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - timedelta(days=60))
            .not_valid_after(now + timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
            .add_extension(usage, critical=True)
            .sign(key, hashes.SHA256())
        )

    pem = serialization.Encoding.PEM

    def write(
        file: str,
        key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey,
        certificate: x509.Certificate,
        secret: bytes = b"",
    ) -> None:
        plain = serialization.NoEncryption()
        hidden = serialization.BestAvailableEncryption(secret) if secret else plain
        text = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, hidden)
        (folder / file).write_bytes(text + certificate.public_bytes(pem))

    good = certified(of_rsa)
    write("rsa.pem", of_rsa, good)
    (folder / "trusted.pem").write_bytes(good.public_bytes(pem))
    write("curve.pem", of_curve, certified(of_curve))
    write("secret.pem", of_rsa, good, b"secret")
    write("old.pem", of_rsa, certified(of_rsa, days=-1))
    write("stranger.pem", of_curve, good)
    hidden = serialization.BestAvailableEncryption(b"secret")
    packed = pkcs12.serialize_key_and_certificates(b"lab", of_rsa, good, None, hidden)
    (folder / "secret.p12").write_bytes(packed)
    return folder


@pytest.mark.parametrize("key", ["rsa.pem", "curve.pem", "secret.pem", "secret.p12"])
def test_a_signature_is_verified(
    key: str,
    keys: Path,
    order: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    faults_of: Callable[[str], list[str]],
) -> None:
    from cryptography import x509
    from signxml.exceptions import InvalidDigest
    from signxml.xades.xades import XAdESVerifier

    monkeypatch.setenv("GLIDECAL_KEY_PASSWORD", "secret")
    target = tmp_path / "c.xml"
    arguments = ("report", SIMULATED, "--certificate", order, "--sign", keys / key, "-o", target)
    run = glidecal(*arguments)
    assert run.status == 0, run.err
    xml = target.read_bytes()
    assert faults_of(xml.decode()) == []
    certificate_path = keys / ("curve.pem" if key == "curve.pem" else "trusted.pem")
    (trusted,) = x509.load_pem_x509_certificates(certificate_path.read_bytes())
    checked = XAdESVerifier().verify(xml, x509_cert=trusted, expect_references=3)
    signed = [part.signed_xml for part in checked if part.signed_xml is not None]
    assert "{https://ptb.de/dcc}digitalCalibrationCertificate" in [part.tag for part in signed]
    changed = xml.replace(b"<si:value>0", b"<si:value>1", 1).replace(b"<si:value>-", b"<si:value>")
    assert changed != xml
    with pytest.raises(InvalidDigest):
        XAdESVerifier().verify(changed, x509_cert=trusted, expect_references=3)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_another_library_verifies_the_signature(
    dcc: ModuleType,
    keys: Path,
    order: Path,
    tmp_path: Path,
) -> None:
    target = tmp_path / "c.xml"
    signing = ("--certificate", order, "--sign", keys / "rsa.pem")
    run = glidecal("report", SIMULATED, *signing, "-o", target)
    assert run.status == 0, run.err
    store = dcc.DCCTrustStore()
    store.load_trusted_root_from_file(str(keys / "trusted.pem"))
    certificate = dcc.DCC(byte_array=target.read_bytes(), trust_store=store)
    assert certificate.status_report.is_signed
    assert certificate.status_report.valid_signature
    assert abs((certificate.get_signing_time() - datetime.now(UTC)).total_seconds()) < 300.0


@pytest.mark.parametrize(
    ("key", "status", "words"),
    [
        ("secret.pem", 2, "a key with a password"),
        ("old.pem", 3, "one that is valid today"),
        ("stranger.pem", 3, "no certificate of this key"),
        ("trusted.pem", 3, "no key that can be read"),
        ("none.pem", 3, "No such file"),
    ],
)
def test_a_wrong_key_is_one_sentence(
    key: str, status: int, words: str, keys: Path, order: Path, tmp_path: Path
) -> None:
    target = tmp_path / "c.xml"
    arguments = ("report", SIMULATED, "--certificate", order, "--sign", keys / key, "-o", target)
    assert words in refused(status, *arguments)
    assert not target.exists()


def test_a_wrong_password_is_one_sentence(
    keys: Path, order: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GLIDECAL_KEY_PASSWORD", "guessed")
    arguments = ("report", SIMULATED, "--certificate", order, "--sign", keys / "secret.pem")
    assert "another password" in refused(3, *arguments, "-o", tmp_path / "c.xml")


def test_only_a_certificate_as_xml_is_signed(order: Path, tmp_path: Path) -> None:
    arguments = ("report", SIMULATED, "--sign", "key.pem", "-o", tmp_path / "c.pdf")
    assert "--sign: found --output" in refused(2, *arguments, "--certificate", order)
