"""Where no LinuxCNC can be started, one sentence says why; `tests/controller` starts one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from calib.errors import MotionError, UsageError
from drivers.motion import headless
from tests.app.cli import refused

pytestmark = pytest.mark.skipif(os.name != "posix", reason="shell scripts in the place of programs")


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """All that is needed, as programs that find nothing and do nothing."""
    for name in headless.PROGRAMS:
        (tmp_path / name).write_text("#!/bin/sh\nexit 1\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setenv("RTAPI_UID", "65534")
    monkeypatch.setattr(headless, "LOCK", tmp_path / "lock")
    headless.check_linuxcnc()
    return tmp_path


def test_without_linuxcnc_the_command_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    folder = tmp_path / "demo"
    message = refused(2, "demo", "--controller", "linuxcnc", "--headless", "--folder", folder)
    for words in ("no linuxcnc here", "apt install linuxcnc-uspace", "--controller twin"):
        assert words in message
    assert not folder.exists()


def test_as_root_it_does_not_start(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RTAPI_UID")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    with pytest.raises(UsageError, match="root"):
        headless.check_linuxcnc()


@pytest.mark.parametrize("sign", ["lock", "process"])
def test_one_that_runs_is_left_alone(installed: Path, sign: str) -> None:
    """The start script of LinuxCNC would end it: of a machine, perhaps."""
    if sign == "lock":
        (installed / "lock").touch()
    else:
        (installed / "pidof").write_text("#!/bin/sh\necho 1\n")
    with pytest.raises(UsageError, match="would end it"):
        headless.check_linuxcnc()


def test_what_it_said_when_it_did_not_start(installed: Path) -> None:
    (installed / "linuxcnc").write_text("#!/bin/sh\necho no realtime here\nexit 1\n")
    at = (0.0, 0.0, 0.0)
    joints = headless.SimulatedJoints(at, at, at, at, 1.0, at, {})
    before = {**os.environ}
    with pytest.raises(MotionError, match="no realtime here"):
        headless.HeadlessLinuxCnc(joints)
    assert {**os.environ} == before
