"""What the form before a session decides, without a terminal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from app.measuring.gauges import PushResult, SpindleCheck
from app.measuring.indicators import remember
from app.measuring.preparation import Form, Preparation, ProfileTrial, retyped
from app.report.text.preparing import indicator_fields, prepared_texts, trial_text
from app.settings import data_path
from calib.errors import UsageError
from drivers.profile import Spindle
from drivers.profiles import PROFILES
from drivers.twins import IndicatorTwin, TwinPort
from protocols.machine import Instrument, Machine
from protocols.procedure import load_procedure

EMPTY = dict.fromkeys(
    ("machine", "serial", "place", "operator", "temperature", "note", "random", "motion"), ""
)
SYLVAC = Instrument(profile="sylvac", port="/dev/ttyNONE7", axes="yx")


@pytest.fixture(autouse=True)
def _own_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def prepared(**typed: str) -> Preparation:
    preparation = Preparation()
    preparation.retype(EMPTY | typed)
    return preparation


def test_the_machine_decides_what_is_offered_until_another_procedure_is_chosen() -> None:
    preparation = prepared(procedure="zero-max-min")
    assert preparation.fields["procedure"] == "zero-max-min"
    preparation.retype(EMPTY | {"procedure": "sweep"})
    assert preparation.fields["procedure"] == "sweep"
    preparation.retype(EMPTY | {"procedure": "sweep", "motion": "grbl:/dev/ttyACM0"})
    assert preparation.fields["procedure"] == "sweep", "chosen, not usual"
    preparation.retype(EMPTY | {"procedure": "sweep", "machine": "linear-delta"})
    assert preparation.fields["procedure"] == preparation.procedures[0] == "plate-rings"
    assert preparation.typed["procedure"] == "plate-rings"


def test_what_was_used_last_is_proposed_until_an_indicator_is_chosen() -> None:
    remember("orthoglide", [SYLVAC], "OG-7", "hall 3")
    preparation = prepared()
    assert preparation.forms[0]["port"] == SYLVAC.port
    assert preparation.source == "last"
    assert (preparation.typed["serial"], preparation.typed["place"]) == ("OG-7", "hall 3")
    preparation.retype(EMPTY | {"serial": "OG-8"})
    assert preparation.typed["serial"] == "OG-8", "proposed once"
    preparation.choose(0, {})
    assert not preparation.source
    with pytest.raises(UsageError, match="words of the screen"):
        preparation.plan("words of the screen")


def test_a_file_may_name_its_indicator_but_no_port_elsewhere(tmp_path: Path) -> None:
    remember("orthoglide", [SYLVAC])
    path = tmp_path / "own.toml"
    words = 'schema = "glidecal.machine/1"\n[[indicator]]\nprofile = "tesa"\nport = "{}"\n'
    path.write_text(words.format("/dev/ttyUSB5"), encoding="utf-8")
    preparation = prepared(machine=str(path))
    assert (preparation.forms[0]["profile"], preparation.source) == ("tesa", "file")
    path.write_text(words.format("socket://example.org:1"), encoding="utf-8")
    preparation = prepared(machine=str(path))
    assert "example.org" in str(preparation.problem)
    assert preparation.procedures
    assert prepared_texts(preparation)[0] == str(preparation.problem)


def test_a_damaged_memory_and_a_machine_that_is_none_are_told() -> None:
    remember("orthoglide", [SYLVAC])
    data_path().write_text("{", encoding="utf-8")
    preparation = prepared()
    assert "Remove the file" in str(preparation.forgotten)
    assert preparation.problem is None
    preparation.retype(EMPTY)
    assert preparation.forgotten is None, "told once"
    preparation.retype(EMPTY | {"machine": "nothing.toml"})
    assert "nothing.toml" in prepared_texts(preparation)[0]


def test_another_profile_has_another_pattern_and_what_is_no_value_is_left_out() -> None:
    form: Form = {"profile": "ascii-line", "port": "/dev/ttyUSB0", "pattern": "(?P<mm>.+)"}
    typed = {"here": "/dev/ttyUSB3", "profile": "tesa", "port": "/dev/ttyUSB0", "axes": "xyz"}
    assert retyped(form, typed) == {"profile": "tesa", "port": "/dev/ttyUSB0"}


def test_the_form_of_an_indicator_has_what_is_known_of_it() -> None:
    fields = {f.name: f for f in indicator_fields({"port": "COM5", "axes": "zyx"}, {})}
    assert fields["port"].value == "COM5"
    assert fields["axes"].rows is not None
    assert fields["axes"].rows[-1] == ("z, else y, else x", "zyx")
    assert fields["profile"].rows is not None
    assert len(fields["profile"].rows) == len(PROFILES)


def test_a_trial_finds_who_fits_and_nothing_once_it_is_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = {k: replace(p, timeout_s=0.15, interval_s=0.0) for k, p in PROFILES.items()}
    monkeypatch.setattr("app.measuring.preparation.PROFILES", quick)
    with TwinPort(IndicatorTwin(PROFILES["tesa"], Spindle(lambda: 0.5, 0.001)), "tcp") as twin:
        trial = ProfileTrial({"port": twin.url})
        asked: list[object] = []
        findings = trial.run(lambda *group: asked.append(group))
        assert asked
        assert any("tesa fits" in finding.description for finding in findings)
        assert trial.best("tesa") == "tesa"
        assert trial.best("mitutoyo-01a") == trial.best(None) == "sylvac", "somebody verified it"
        stopped = ProfileTrial({"port": twin.url})
        stopped.stop()
        assert stopped.run(print) == []
    gone = ProfileTrial({"port": "socket://127.0.0.1:1"})
    assert not gone.run(print)[0].well
    with pytest.raises(UsageError, match="port: found none"):
        ProfileTrial({})


def test_a_port_keeps_its_capitals_at_the_beginning_of_a_sentence() -> None:
    """A port of another case is another port."""
    two = tuple(Instrument(profile="sylvac", port=f"/dev/ttyUSB{k}", axes="yx") for k in range(2))
    step = load_procedure("zero-max-min", Machine().geometry()).steps(
        Machine().geometry(), ("yx", "zx")
    )[0]
    words = trial_text(SpindleCheck(two, finding=PushResult.OTHER), step)
    assert words.startswith("Indicator 2 (sylvac, /dev/ttyUSB1) moved.")
