"""What contacts tell of a machine: simulated by geometry alone, nothing of it shared."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_sessions
from app.evaluating.what_if import what_if
from calib.diagnosis.results import Diagnosis
from calib.posterior.models import Posterior
from protocols.machine import load_machine
from protocols.machine_files import MACHINES
from protocols.session import Session, fold
from protocols.table import opened_table
from tests.app.cli import glidecal
from tests.blind.linear_delta import Hidden, Three, contacts, places, table, touched
from tests.conftest import LONG, first_quick

OF_INDICATORS = {
    *("gauge_gain", "gauge_tilt", "gauge_sign", "gauge_swap", "gauge_hysteresis"),
    *("unit_mixup", "stand_slip", "stand_drift", "tip_on_round_bar", "label_error"),
    *("tables_exchanged", "legs_exchanged", "postures_exchanged", "leg_taper", "leg_bow"),
}
SESSIONS = 100
"""Of a sound machine; each takes half a second. Of 240 such sessions 237 agreed (98.8 %)."""


def session(folder: Path, text: str, name: str = "t.csv") -> Session:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    opened, events, _ = opened_table(path, load_machine("linear-delta"), "test")
    return fold([opened, *events])


def three(values: np.typing.NDArray[np.float64]) -> Three:
    x, y, z = values.tolist()
    return x, y, z


def sound(seed: int) -> Hidden:
    """Switches and bars as such machines have them: tolerances of the machine file."""
    chance = np.random.default_rng([9, seed])
    return Hidden(
        offset_mm=three(chance.normal(scale=1.0, size=3)),
        length_mm=three(chance.normal(scale=0.3, size=3)),
    )


def names(result: Posterior, diagnosis: Diagnosis) -> set[str]:
    """Everything that may be said of the readings: components, mistakes, names, rivals."""
    return {
        *(component.id for component in result.components),
        *(name for name, _ in result.mistakes),
        *(candidate.id for candidate in diagnosis.candidates),
        *(effect.id for effect in diagnosis.effects),
        *(rival.id for effect in diagnosis.effects for rival in effect.indistinguishable_from),
    }


@LONG
def test_nothing_hidden_agrees_and_nothing_of_an_indicator_is_ever_named(tmp_path: Path) -> None:
    agreed, of_indicators = 0, set()
    for seed in range(SESSIONS):
        diagnosed = diagnose_sessions([session(tmp_path, contacts(sound(seed), seed))])
        agreed += diagnosed.diagnosis.verdict == "agrees"
        of_indicators |= names(diagnosed.corrections.posterior, diagnosed.diagnosis)
    assert agreed >= 0.97 * SESSIONS
    assert not of_indicators & OF_INDICATORS
    assert {"plate_tilt", "backlash", "actuator_scale"} <= of_indicators


@LONG
def test_readings_of_an_indicator_keep_its_names(tmp_path: Path) -> None:
    result = diagnose_sessions([session(tmp_path, table(Hidden(), 1))])
    ids = names(result.corrections.posterior, result.diagnosis)
    assert {"gauge_gain", "gauge_tilt"} <= ids
    assert "plate_tilt" not in ids


@LONG
@pytest.mark.parametrize("scale", [8e-3, -8e-3])
def test_a_belt_is_named_in_contacts(tmp_path: Path, scale: float) -> None:
    hidden = Hidden(offset_mm=(0.4, -0.3, 0.1), scale=(0.0, scale, 0.0))
    diagnosis = diagnose_sessions([session(tmp_path, contacts(hidden, 3))]).diagnosis
    assert diagnosis.verdict != "agrees"
    ids = {(effect.id, effect.where) for effect in diagnosis.effects}
    assert ("actuator_scale", "y") in ids


@LONG
@pytest.mark.parametrize("bow_mm", first_quick([-0.5, 0.4]))
def test_a_round_plate_and_a_wrong_radius_are_rivals(tmp_path: Path, bow_mm: float) -> None:
    """A dish of ten tolerances was called towers 1.26 mm too far out, with 0.98."""
    header, *lines = contacts(Hidden(), 3).splitlines()
    x, y, z = (header.split(",").index(name) for name in ("x_mm", "y_mm", "z_mm"))
    rows = [line.split(",") for line in lines]
    for row in rows:
        lower_mm = bow_mm * (float(row[x]) ** 2 + float(row[y]) ** 2) / 100.0**2
        row[z] = f"{float(row[z]) - lower_mm:.4f}"
    path = tmp_path / "t.csv"
    path.write_text("\n".join([header, *map(",".join, rows)]), encoding="utf-8")
    machine = load_machine("linear-delta").model_copy(update={"plate_bow_tolerance_mm": 0.05})
    opened, events, _ = opened_table(path, machine, "test")
    measured = fold([opened, *events])
    (effect,) = diagnose_sessions([measured]).diagnosis.effects
    rivals = {(rival.id, rival.where) for rival in effect.indistinguishable_from}
    assert {("plate_bow", "tz"), ("axis_offset", "all")} <= {(effect.id, effect.where), *rivals}
    if effect.id == "plate_bow":
        (size,) = effect.parameters
        assert size.value == pytest.approx(bow_mm, abs=0.03)
    trial = what_if([measured], "plate_bow:tz", [bow_mm])
    assert trial.result.solution.rms_after_mm < 0.1 * abs(bow_mm)


@LONG
def test_one_contact_beside_dirt_is_a_mistake_in_words_of_contacts(tmp_path: Path) -> None:
    lines = contacts(sound(2), 5).splitlines()
    x, y, z, height, cycle = lines[25].split(",")
    lines[25] = f"{x},{y},{float(z) + 0.3:.4f},{height},{cycle}"
    path = tmp_path / "dirt.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    out = tmp_path / "dirt.jsonl"
    ran = ("import", path, "-o", out, "--machine", "linear-delta")
    assert glidecal(*ran).status == 0
    run = glidecal("diagnose", out, "--json")
    diagnosis = json.loads(run.out)
    assert [effect["id"] for effect in diagnosis["effects"]] == ["wild_reading"]
    assert "one contact is wrong" in diagnosis["effects"][0]["title"]


@LONG
def test_contacts_and_readings_of_a_plate_stand_in_one_solution(tmp_path: Path) -> None:
    """A session of each, of one machine: the gain is that of the indicator alone."""
    hidden = Hidden(offset_mm=(0.9, -0.6, 0.2), length_mm=(0.2, 0.0, -0.2), gain=0.2)
    by_contacts = session(tmp_path, contacts(hidden, 4), "contacts.csv")
    by_readings = session(tmp_path, table(hidden, 4), "readings.csv")
    diagnosis = diagnose_sessions([by_contacts, by_readings]).diagnosis
    gains = [effect for effect in diagnosis.effects if effect.id == "gauge_gain"]
    assert [named.where for named in gains] == ["tz"]
    (size,) = gains[0].parameters
    assert size.value == pytest.approx(20.0, abs=3.0 * size.standard_uncertainty)


@LONG
def test_texts_of_contacts_name_no_indicator(tmp_path: Path) -> None:
    for cycles, name in ((3, "repeated"), (1, "once")):
        path, out = tmp_path / f"{name}.csv", tmp_path / f"{name}.jsonl"
        path.write_text(contacts(sound(7), 7, cycles=cycles), encoding="utf-8")
        glidecal("import", path, "-o", out, "--machine", "linear-delta")
        page = tmp_path / f"{name}.html"
        assert glidecal("report", out, "-o", page).status == 0
        for text in (
            glidecal("solve", out).out,
            glidecal("diagnose", out).out,
            glidecal("replay", out, "--headless").out,
            page.read_text(encoding="utf-8"),
        ):
            assert text
            assert "indicator" not in text.lower(), name


@LONG
def test_places_are_compared_however_high_the_plate_was_met(tmp_path: Path) -> None:
    """Before and after values were entered: each place by itself, what is left of each offset."""
    first, again = Hidden(offset_mm=(0.4, -0.3, 0.2)), Hidden(offset_mm=(0.1, 0.1, 0.1))
    entered = (0.3, -0.4, 0.1)
    shipped = (MACHINES / "linear-delta.toml").read_text(encoding="utf-8")
    paths = []
    for number, (hidden, values) in enumerate(((first, (0.0, 0.0, 0.0)), (again, entered))):
        name = tmp_path / f"{number}"
        machine, source, path = (name.with_suffix(end) for end in (".toml", ".csv", ".jsonl"))
        machine.write_text(
            shipped.replace("offsets_mm = [0.0, 0.0, 0.0]", f"offsets_mm = {list(values)}"),
            encoding="utf-8",
        )
        source.write_text(contacts(hidden, number), encoding="utf-8")
        assert glidecal("import", source, "-o", path, "--machine", machine).status == 0
        paths.append(path)
    compared = json.loads(glidecal("compare", *paths, "--json").out)
    assert len(compared["differences"]) == 19
    assert compared["rms_before_mm"] > 0.1
    assert compared["rms_after_mm"] < 0.005
    # what three spheres say: so much the tool is higher than commanded, less the mean of all places
    places_mm = np.array([place[:2] for _, place in places(1)[:19]])
    higher = -np.array([touched(first, place)[2] for place in places_mm])
    higher -= higher.mean()
    (at,) = np.flatnonzero((places_mm == [0.0, 80.0]).all(axis=1))
    assert compared["differences"]["z(0, 80)"]["before"] == pytest.approx(higher[at], abs=0.01)
    run = glidecal("verify", *paths, "--tolerance", "0.2")
    assert run.status == 0, run.err
