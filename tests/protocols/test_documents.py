"""Machine and model files: strict, with errors that name the key and the value."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import Field

from calib.errors import RecordError
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from protocols.documents import Document, Name, read_remembered
from protocols.machine import Machine, load_machine, machine_text
from protocols.model_file import model_file, read_model


def test_default_machine_is_the_prototype() -> None:
    assert load_machine(None).geometry() == Geometry((310.25,) * 3, 60.0, -100.0, 80.0, 31.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("leg_length = 300\n", "leg_length: no such key"),
        ('leg_length_mm = "300"\n', "leg_length_mm"),
        ("leg_length_mm = -3.0\n", "must be at least 0.001 \\(found -3.0\\)"),
        ("leg_length_mm = nan\n", "leg_length_mm"),
        ("leg_length_mm = 310,25\n", "at line 1, column 20.*Write decimals with a point"),
        ("[motion]\nreached_mm = 1.1\n", "must be at most 1 \\(found 1.1\\)"),
        ("fastest_feed_mm_min = 0.9\n", "must be at least 1 \\(found 0.9\\)"),
        ("leg_length_mm = inf\n", "leg_length_mm"),
        ('[[indicator]]\nprofile = "x"\ncertificate_date = "soon"\n', "must be a date as 2026-"),
        ("usable_bar = [0.1]\n", "usable_bar.1: missing"),
        ('frame = "foo"\n', "frame: must be 'touched-off', 'aligned' or 'machine' .found 'foo'"),
        ("travel_max_mm = -1.0\n", "joint limits"),
        ("travel_max_mm = 400.0\n", "travel_max_mm"),
        ("home_offset_mm = [1.0, 2.0]\n", "home_offset_mm"),
        ("leg_length_mm = \n", "TOML"),
    ],
)
def test_bad_machine_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        load_machine(path)


@pytest.mark.parametrize("text", ["", "# to do\n", 'schema = "glidecal.machine/1"\n'])
def test_a_machine_file_that_states_nothing_is_no_machine(tmp_path: Path, text: str) -> None:
    """Before: it was the machine of the papers."""
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"m\.toml: found no key but schema\. Allowed: at least"):
        load_machine(path)
    path.write_text(machine_text(Machine(), ()))
    assert load_machine(path) == Machine()


@pytest.mark.parametrize("text", ["{}", '{"schema": "glidecal.model/1"}'])
def test_a_model_that_states_nothing_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "m.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=r"m\.json: found no key but schema\. Allowed: a machine"):
        read_model(path)


def test_missing_machine_file(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="No such file"):
        load_machine(tmp_path / "none.toml")


class Remembered(Document):
    machines: dict[Name, str] = Field(default_factory=dict)


def test_what_the_program_remembers_of_itself(tmp_path: Path) -> None:
    path = tmp_path / "machines.json"
    assert read_remembered(path, Remembered, "machines,") == Remembered()
    path.write_text('{"machines": {"a": "b"}}', encoding="utf-8")
    assert read_remembered(path, Remembered, "machines,").machines == {"a": "b"}
    path.write_text('{"machines": {"a": 1}}', encoding="utf-8")
    with pytest.raises(
        RecordError, match=r"machines, .*machines\.a: must be a text \(found 1\).*Remove"
    ):
        read_remembered(path, Remembered, "machines,")


def test_model_round_trip(tmp_path: Path) -> None:
    machine = Machine(name="bench 2", leg_length_mm=400.0, home_offset_mm=(1.0, 2.0, 3.0))
    model = Model(machine.geometry(), (0.1, -0.2, 0.3, 0.01, -0.02, 0.03))
    path = tmp_path / "model.json"
    path.write_text(model_file(model, machine).text(), encoding="utf-8")
    assert read_model(path) == (model, machine)
    assert '"schema": "glidecal.model/1"' in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"schema": "glidecal.model/2"}', "schema"),
        ('{"parameters_mm": {"d_rho_w": 1.0}}', "d_rho_w"),
        ('{"parameters_mm": {"d_rho_x": "1"}}', "d_rho_x"),
        ('{"effects": [{"id": "backlash", "where": "x", "parameters": {}}]}', "backlash"),
        ("{", "JSON"),
    ],
)
def test_bad_models(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "model.json"
    path.write_text(text)
    with pytest.raises(RecordError, match=message):
        read_model(path)


def test_each_drive_has_its_own_bar_and_usable_part() -> None:
    three = load_machine("linear-delta").drive
    assert three is not None
    bars, parts = (250.0, 251.0, None), (None, (0.2, 0.7), (0.3, 0.8))
    drives = [
        drive.model_copy(update={"leg_length_mm": bar, "usable_bar": part})
        for drive, bar, part in zip(three, bars, parts, strict=True)
    ]
    machine = Machine(
        leg_length_mm=252.0, usable_bar=(0.1, 0.9), drive=(drives[0], drives[1], drives[2])
    )
    geometry = machine.geometry()
    assert geometry.leg_length_mm == (250.0, 251.0, 252.0)
    assert geometry.usable_bar == ((0.1, 0.9), (0.2, 0.7), (0.3, 0.8))
