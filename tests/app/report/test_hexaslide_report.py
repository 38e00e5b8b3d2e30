"""The report and the history of sessions of postures: numbers, what is refused, hostile names."""

from __future__ import annotations

import json
import re
from datetime import timedelta
from decimal import Decimal
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.hexaslide import posture_result
from app.evaluating.hexaslide_calibration import calibrate_file, verify_sessions
from app.evaluating.history import read_history
from app.machines.registry import LOOKS
from app.report.hexaslide_certificate import certified_postures
from app.report.pages.hexaslide import RULE, report_page, source_of_postures
from app.report.pages.report import html_of
from app.report.text.hexaslide_calibration import deciding_figures
from calib.hexaslide.checked import frames_apart
from calib.hexaslide.geometry import forward, inverse
from protocols.hexaslide import load_hexaslide, machine_like
from protocols.hexaslide_session import POSTURE_FORM, PostureReading, read_postures, simulated_truth
from protocols.journal import write_whole
from protocols.session import Line
from tests.app.cli import glidecal, refused
from tests.app.posture_sessions import TOLERANCE_MM, before_and_after, posture_session
from tests.calib.hexaslide.hexaslide_draws import aligned_rms_m
from tests.conftest import LONG, first_quick


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return before_and_after(tmp_path_factory.mktemp("pair"))


def words(page: str) -> str:
    return " ".join(re.sub(r"<[^>]+>", " ", page).split())


@LONG
def test_the_report_says_what_is_to_be_entered(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """Its values are those of the file that export writes; its error is that of the truth."""
    before, _ = pair
    output = tmp_path / "report.html"
    assert glidecal("report", before, "-o", output).status == 0
    text = words(output.read_text("utf-8"))
    assert glidecal("export", before, "--format", "model", "-o", tmp_path / "m.toml").status == 0
    exported = load_hexaslide(tmp_path / "m.toml")
    for number, chain in enumerate(exported.chain, start=1):
        assert re.search(rf" {number} link_mm \+880\.0000 \+{chain.link_mm:.4f} ", text)
        for axis, value in zip("xyz", chain.joint_mm, strict=True):
            match = re.search(rf" {number} joint_mm {axis} \S+ (\S+) ", text)
            assert match is not None
            assert float(match[1]) == pytest.approx(value, abs=5.1e-5)
    session, _ = read_postures(before)
    truth, machine = simulated_truth(session).whole(), session.opened.machine.whole()
    postures = machine.box.random(400, np.random.default_rng(8))
    stands = forward(truth.geometry, inverse(machine.geometry, postures), truth.box)
    off_mm = 1000.0 * aligned_rms_m(np.asarray(stands)[:, :3], postures[:, :3])
    stated = re.search(r"off by (\S+) mm r\.m\.s\. over the box", text)
    assert stated is not None
    # of 400 and of 200 random postures an r.m.s. varies by a few percent
    assert float(stated[1]) == pytest.approx(off_mm, rel=0.1)
    assert "FAIL, as it was measured" in text
    assert "NOT IDENTIFIABLE, left as the machine file has it: platform frame turned" in text
    assert "SIMULATED" in text
    assert "No session after the values were entered" in text
    assert "error of the platform over the box, mm now calibrated" in text
    assert output.read_text("utf-8").count("data:image/svg+xml") == 2


@LONG
def test_a_later_session_decides(pair: tuple[Path, Path], tmp_path: Path) -> None:
    before, after = pair
    output = tmp_path / "report.pdf"
    run = glidecal("report", before, "--after", after, "-o", output)
    assert run.status == 0, run.err
    assert output.read_bytes().startswith(b"%PDF")
    text = words(html_of(source_of_postures(before, after).page()))
    assert text.count("PASS") == 2, "as the decision, and where it was verified"
    assert f"tolerance {TOLERANCE_MM:g} mm" in text
    assert "Predicted with the calibrated machine: the platform is off by at most" in text
    assert "error of the platform over the box, mm before calibrated" in text  # it was "now"
    streamed = glidecal("report", before, "--after", after, "-o", "-")
    assert words(streamed.out) == text


@LONG
def test_the_report_judges_by_the_tolerance_of_its_verification(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    """Also where the two machine files state different ones: decision, annex and certificate."""
    before, after = pair
    session, _ = read_postures(after)
    machine = session.opened.machine.model_copy(update={"platform_tolerance_mm": 0.07})
    opened = session.opened.model_copy(update={"machine": machine})
    write_whole(other := tmp_path / "other.jsonl", opened, [*session.readings], POSTURE_FORM)
    certified = certified_postures(before, other)
    assert certified.verification is not None
    assert certified.tolerance_mm == certified.verification.tolerance_mm == 0.07
    text = words(html_of(report_page(certified)))
    assert "PASS, measured again" in text
    assert "tolerance 0.07 mm" in text
    assert "tolerance of the platform 0.07 mm r.m.s." in text
    untold = session.opened.machine.model_copy(update={"platform_tolerance_mm": None})
    opened = session.opened.model_copy(update={"machine": untold})
    write_whole(last := tmp_path / "last.jsonl", opened, [*session.readings], POSTURE_FORM)
    assert verify_sessions(before, last, None).tolerance_mm == TOLERANCE_MM


@LONG
def test_nothing_is_entered_that_is_not_shown_to_be_better(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    """Of a machine file that is true the session says to keep it; so does its report."""
    truth = simulated_truth(read_postures(pair[0])[0])
    path = posture_session(tmp_path / "k.jsonl", "position", 12, truth, truth)
    report = words(html_of(source_of_postures(path).page()))
    assert "Keep the file, or measure more" in report
    assert report.count("Change nothing in the controller") == 2
    assert "Enter the calibrated machine" not in report
    assert "Enter the calibrated machine" in words(html_of(source_of_postures(pair[0]).page()))


@LONG
def test_what_fits_badly_does_not_pass_and_says_why(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    """By a noise that is stated five times too small; the rule of the report has it, too."""
    session, _ = read_postures(pair[1])
    procedure = session.opened.procedure
    small = procedure.model_copy(
        update={"noise_mm": procedure.noise_mm / 5.0, "noise_deg": procedure.noise_deg / 5.0}
    )
    opened = session.opened.model_copy(update={"procedure": small})
    write_whole(after := tmp_path / "after.jsonl", opened, [*session.readings], POSTURE_FORM)
    run = glidecal("verify", pair[0], after, "--tolerance", "100")
    assert run.status == 7
    text = " ".join(run.out.split())
    assert "More is left of the readings than noise, so the machine does not pass" in text
    assert "Measure more postures" not in text
    assert "and no more is left of the readings than noise" in RULE


@pytest.mark.parametrize("tolerance", [0.1, 0.0563, 7.5])
def test_figures_beside_a_tolerance_show_what_was_decided(tolerance: float) -> None:
    """0.06334 and 0.03674 are 0.10008 together, as 0.0633 and 0.0367 they were 0.1000: a reader
    adds them up in decimals.
    """
    assert deciding_figures(0.06334, 0.03674, 0.1) == ("0.06334", "0.03674")
    assert deciding_figures(0.06334, 0.03674, 0.2) == ("0.0633", "0.0367")
    chance, limit = np.random.default_rng(4), Decimal(str(tolerance))
    for _ in range(300):
        off = tolerance * chance.uniform(0.0, 2.0)
        bound = abs(tolerance - off) + tolerance * chance.normal(0.0, 1e-4)
        first, second = map(Decimal, deciding_figures(off, bound, tolerance))
        assert (first + second <= limit) == (off + bound <= tolerance)
        assert (first - second > limit) == (off - bound > tolerance)


def test_what_a_report_of_postures_does_not_take(pair: tuple[Path, Path], tmp_path: Path) -> None:
    before, after = pair
    output = tmp_path / "r.html"
    assert "one of this kind" in refused(2, "report", before, after, "-o", output)
    assert "--model" in refused(2, "report", before, "--model", before, "-o", output)
    assert ".html, .pdf, .xml" in refused(2, "report", before, "-o", tmp_path / "r.txt")
    measurements = tmp_path / "m.json"
    measured = read_postures(before)[0].measurements()
    measurements.write_text(measured.text(), encoding="utf-8")
    refused(3, "report", measurements, "-o", output)
    assert not output.exists()


@LONG
def test_too_few_spare_readings_are_said(tmp_path: Path) -> None:
    """With whole postures without noise nothing can be diagnosed, and the report says so."""
    path = posture_session(tmp_path / "s.jsonl", "pose-forward", 3)
    session, record = read_postures(path)
    procedure = session.opened.procedure.model_copy(update={"noise_mm": 0.0, "noise_deg": 0.0})
    opened = session.opened.model_copy(update={"procedure": procedure})
    write_whole(tmp_path / "n.jsonl", opened, list(record.events[1:-1]), POSTURE_FORM)
    result = posture_result(tmp_path / "n.jsonl")
    assert result.diagnosis is None
    assert "NOT DIAGNOSED. diagnosis: found no stated noise" in words(
        html_of(source_of_postures(tmp_path / "n.jsonl").page())
    )


def test_strange_names_stay_texts(tmp_path: Path) -> None:
    path = posture_session(tmp_path / "s.jsonl", "position", 4)
    session, record = read_postures(path)
    machine = session.opened.machine.model_copy(update={"name": "<script>a</script>\u202e{{ 7 }}"})
    opened = session.opened.model_copy(update={"machine": machine, "operator": "[red]x<b>"})
    write_whole(tmp_path / "h.jsonl", opened, list(record.events[1:-1]), POSTURE_FORM)
    page = html_of(source_of_postures(tmp_path / "h.jsonl").page())
    assert "<script" not in page
    assert "\u202e" not in page
    assert "&lt;script&gt;a&lt;/script&gt;" in page


@LONG
def test_the_history_is_that_of_one_machine(pair: tuple[Path, Path], tmp_path: Path) -> None:
    """A calibrated machine is the one that it was before, and what was entered is an event."""
    for path in pair:
        session, record = read_postures(path)
        later = timedelta(days=40 if path.stem == "after" else 0)
        opened = session.opened.model_copy(update={"at": session.opened.at + later})
        write_whole(tmp_path / path.name, opened, list(record.events[1:-1]), POSTURE_FORM)
    (tmp_path / "cut.jsonl").write_bytes((tmp_path / "after.jsonl").read_bytes()[:-900])
    index = tmp_path / "index"
    history = read_history(tmp_path, effects=True, index=index, of_postures=LOOKS)
    assert history.machines == ()
    (machine,) = history.of_postures
    assert (machine.machine, machine.origin) == ("hexaslide-h60", "simulated")
    first, second = machine.points
    assert second.event == "machine file changed: chain"
    assert (first.entry.decision, second.entry.decision) == ("fail", "pass")
    assert first.entry.effects == second.entry.effects == ()
    assert first.entry.now_mm is not None
    assert second.entry.now_mm is not None
    assert second.entry.now_mm < 0.02 * first.entry.now_mm
    assert [path.name for path, _ in history.problems] == ["cut.jsonl"]
    assert read_history(tmp_path, index=index, of_postures=LOOKS) == history, "as it is remembered"
    text = glidecal("history", tmp_path).out
    assert "hexaslide-h60, simulated: 2 sessions" in text
    document = json.loads(glidecal("history", tmp_path, "--json").out)
    sessions = document["posture_machines"][0]["sessions"]
    assert [session["decision"] for session in sessions] == ["fail", "pass"]
    assert glidecal("history", tmp_path, "-o", tmp_path / "h.html").status == 0
    assert "fail" in words((tmp_path / "h.html").read_text("utf-8"))


def test_a_calibrated_name_ends_so_once() -> None:
    machine = load_hexaslide()
    once = machine_like(machine, f"{machine.name}, calibrated", machine.whole())
    assert once.before_calibration == machine.before_calibration == machine.name


def spoilt(path: Path, output: Path, posture: int, off_mm: float) -> Path:
    """The session with the x of one posture wrong, as if mistyped and kept."""
    session, record = read_postures(path)
    events: list[Line] = [
        event.model_copy(update={"values": (event.values[0] + off_mm, *event.values[1:])})
        if isinstance(event, PostureReading) and event.posture == posture
        else event
        for event in record.events[1:-1]
    ]
    write_whole(output, session.opened, events, POSTURE_FORM)
    return output


def truly_off_mm(path: Path) -> float:
    """Truly at the platform with the machine that is exported, frames laid over."""
    session, _ = read_postures(path)
    result = calibrate_file(path, None, 0.0)
    machine, entered = session.opened.machine.whole(), result.fit.machine
    truth = simulated_truth(session).whole()
    postures = machine.box.random(300, np.random.default_rng(9))
    sliders = inverse(machine.geometry, postures)
    stands, believed = (
        forward(hexaslide.geometry, sliders, hexaslide.box) for hexaslide in (truth, entered)
    )
    free = result.fit.laid_over
    return 1000.0 * frames_apart(np.asarray(believed), np.asarray(stands), free).places_rms_m


@LONG
@pytest.mark.parametrize("procedure", first_quick(["position", "pose-forward"]))
def test_a_wrong_posture_does_not_spoil_the_machine(procedure: str, tmp_path: Path) -> None:
    """1 mm in one of the postures: believed, it left 0.11 mm at the platform instead of 0.013."""
    sound = posture_session(tmp_path / "sound.jsonl", procedure, 4)
    wrong = spoilt(sound, tmp_path / "wrong.jsonl", 7, 1.0)
    result = calibrate_file(wrong, None, 0.0)
    assert result.left_out == (7,)
    assert calibrate_file(sound, None, 0.0).left_out == ()
    assert truly_off_mm(wrong) < 1.5 * truly_off_mm(sound)
    assert result.platform.bound_m is not None
    assert truly_off_mm(wrong) < 1000.0 * result.platform.bound_m < 0.03
    text = words(html_of(source_of_postures(wrong).page()))
    assert "LEFT OUT: posture 7. The diagnosis names a mistake there." in text
    assert "posture 7 read or taken wrong" in text
    postures = json.loads(glidecal("solve", wrong, "--json").out)["postures"]
    assert postures["left_out"] == [7]
    assert postures["fitted"] + len(postures["held_out"]) == postures["count"] - 1
