"""``compare`` of two sessions of postures: whether the machine is the same."""

from __future__ import annotations

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.evaluating.hexaslide import compare_postures
from calib.hexaslide.procedures import Procedure
from calib.hexaslide.residuals import Readings
from tests.app.cli import glidecal, refused
from tests.app.hexaslide_hidden import hidden_session, machine_file, written
from tests.app.posture_sessions import before_and_after, posture_session
from tests.blind.hexaslide import POSTURES, Hidden, Plain, measured
from tests.calib.hexaslide.telescopic_draws import FILE, NOISE_M, NOISE_RAD, PLAIN, some
from tests.conftest import LONG

SOUND = Hidden(None)
SCALE = Hidden("rail_scale", 2, 5e-4)


def document(first: Path, second: Path) -> dict[str, Any]:
    run = glidecal("compare", first, second, "--json")
    assert run.status == 0, run.err
    report: dict[str, Any] = json.loads(run.out)
    return report


@LONG
def test_a_machine_whose_file_was_calibrated_is_the_same_machine(tmp_path: Path) -> None:
    """The other file has other numbers for everything, and frames that nothing shows."""
    before, after = before_and_after(tmp_path)
    compared = document(before, after)
    assert compared["schema"] == "glidecal.hexaslide-comparison/1"
    assert compared["changed"] is False
    assert 0.01 < compared["p_value"] <= 1.0
    assert compared["platform_rms_mm"] < compared["platform_chance_mm"] < 0.1
    assert compared["platform_rms_mm"] < compared["platform_largest_mm"]
    assert len(compared["laid_over"]) == 3
    assert len(compared["lengths"]) == 26
    beyond = [
        name
        for name, length in compared["lengths"].items()
        if abs(length["difference_mm"]) > length["expanded_mm"]
    ]
    assert len(beyond) <= 9, "lengths of one joint go together"
    text = " ".join(glidecal("compare", before, after).out.split())
    assert "before.jsonl and after.jsonl: no change shows" in text
    assert "Laid over, for no reading shows it: platform frame turned" in text


@LONG
def test_play_that_came_is_a_change(tmp_path: Path) -> None:
    before = hidden_session(tmp_path / "before.jsonl", SOUND)
    after = hidden_session(tmp_path / "after.jsonl", Hidden("backlash", 1, 1e-4), take=1)
    compared = document(before, after)
    assert compared["changed"] is True
    assert compared["p_value"] < 1e-6
    assert compared["platform_rms_mm"] > 1.5 * compared["platform_chance_mm"]
    assert compared["after"]["named"] == [{"id": "backlash", "where": "rail 2"}]
    text = " ".join(glidecal("compare", before, after).out.split())
    assert "the machine changed; one machine would differ so much with a chance below 1e-06" in text
    assert "calibrate from the second session" in text


def _halves(
    folder: Path, seed: int, cause: Hidden, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, Path]:
    """One machine with a cause about one middle, measured in two halves."""
    count = POSTURES["position"]
    monkeypatch.setitem(POSTURES, "position", 2 * count)
    chance, file = np.random.default_rng(seed), machine_file()
    readings = measured(Plain(file, chance), file, "position", cause, chance)
    first = np.arange(2 * count) < count
    monkeypatch.undo()
    sessions = (
        written(folder / f"{seed}-{name}.jsonl", file, replace(readings.take(rows), numbers=()))
        for name, rows in (("first", first), ("second", ~first))
    )
    before, after = sessions
    return before, after


@LONG
def test_an_effect_that_both_sessions_have_is_no_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compared = document(*_halves(tmp_path, 7001, SCALE, monkeypatch))
    assert compared["changed"] is False
    assert [state["named"] for state in (compared["before"], compared["after"])] == [
        [{"id": "rail_scale", "where": "rail 3"}]
    ] * 2


def test_a_joint_that_was_moved_shows_in_its_lengths(tmp_path: Path) -> None:
    """0.05 mm of a link: twice what noise makes at the platform."""
    chance, file = np.random.default_rng(3), machine_file()
    true = Plain(file, chance)
    moved = copy.deepcopy(true)
    moved.link[4] += 5e-5
    before, after = (
        written(
            tmp_path / f"{name}.jsonl", file, measured(machine, file, "position", SOUND, chance)
        )
        for name, machine in (("before", true), ("after", moved))
    )
    compared = document(before, after)
    assert compared["changed"] is True
    assert compared["platform_rms_mm"] == pytest.approx(0.075, abs=0.03)


@LONG
def test_legs_of_a_platform(tmp_path: Path) -> None:
    chance = np.random.default_rng(4)
    truth = PLAIN.off(chance)
    moved = copy.deepcopy(truth)
    moved.zero[2] += 1e-4
    sessions = []
    for number, machine in enumerate((truth, truth, moved)):
        postures = some(30, 40 + number)
        read = np.array([PLAIN.reads(posture) for posture in postures])
        pairs = zip(read, postures, strict=True)
        stood = np.array([machine.stands(*pair) for pair in pairs])[:, :3]
        values = stood + NOISE_M * chance.normal(size=stood.shape)
        readings = Readings(Procedure.of("position"), read, values, NOISE_M, NOISE_RAD)
        sessions.append(written(tmp_path / f"{number}.jsonl", FILE, readings))
    assert document(sessions[0], sessions[1])["changed"] is False
    changed = document(sessions[0], sessions[2])
    assert changed["changed"] is True
    assert changed["lengths"]["l3"]["difference_mm"] == pytest.approx(
        0.1, abs=1.5 * changed["lengths"]["l3"]["expanded_mm"]
    )


@LONG
def test_sessions_that_tell_too_little_and_those_that_do_not_fit(tmp_path: Path) -> None:
    sound = hidden_session(tmp_path / "sound.jsonl", SOUND)
    few = hidden_session(tmp_path / "few.jsonl", SOUND, count=17)
    compared = document(sound, few)
    assert compared["changed"] is None
    assert compared["p_value"] is None
    assert "not known whether" in glidecal("compare", sound, few).out
    assert "the same postures" in refused(3, "compare", sound, sound)
    for number, update in enumerate(({"name": "another"}, {"serial_number": "2"})):
        other_file = machine_file().model_copy(update=update)
        path = tmp_path / f"other{number}.jsonl"
        other_session = posture_session(path, "position", 3, machine=other_file)
        assert "different machines" in refused(5, "compare", sound, other_session)
    assert "hexaslide-h60, no. 2" in glidecal("solve", other_session).out
    listed = glidecal("history", tmp_path).out
    assert "hexaslide-h60, no. 2" in listed
    assert "no-such" in refused(3, "compare", sound, tmp_path / "no-such.jsonl")


def test_without_a_stated_noise_what_is_left_tells_it(tmp_path: Path) -> None:
    """Parameters alone are compared then."""
    sessions = []
    for take in (0, 1):
        chance, file = np.random.default_rng([9, take]), machine_file()
        true = Plain(file, np.random.default_rng(9))
        readings = measured(true, file, "position", SOUND, chance)
        silent = replace(readings, length_noise_m=0.0, angle_noise_rad=0.0)
        sessions.append(written(tmp_path / f"{take}.jsonl", file, silent))
    compared = document(*sessions)
    assert compared["changed"] is False
    assert compared["before"]["verdict"] is None
    assert "no noise is stated; parameters alone" in " ".join(
        glidecal("compare", *sessions).out.split()
    )


@LONG
def test_one_machine_is_called_changed_as_often_as_chance_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sound ones, and those with a cause: 1 of 100 is expected."""
    causes = (SOUND, SCALE, Hidden("backlash", 2, 1e-4), Hidden("straightness", 2, 5e-4, 1.0))
    changed = [
        compare_postures(*_halves(tmp_path, 7000 + seed, causes[seed % 4], monkeypatch)).apart
        for seed in range(60)
    ]
    p_values = np.array([apart.p_value for apart in changed], dtype=float)
    assert (p_values < 0.01).sum() <= 3
    assert 0.3 < np.median(p_values) < 0.9
