"""The machine moves itself through a real LinuxCNC: right readings or none."""

from __future__ import annotations

from pathlib import Path

from drivers.motion.twins import Trouble
from tests.controller.self_running import DIED, commanded


def test_whatever_befalls_the_controller_no_reading_is_wrong_and_it_goes_on(tmp_path: Path) -> None:
    kinds = (Trouble.NAK, Trouble.ESTOP, Trouble.FOLLOWING, Trouble.HANG_UP, DIED)
    told = commanded(tmp_path, "disturbed", "28", "5", *kinds)
    assert told["wrong"] == []
    assert told["met"] == 5


def test_a_killed_program_leaves_it_at_rest(tmp_path: Path) -> None:
    told = commanded(tmp_path, "killed")
    assert 2.0 <= float(str(told["there_mm"])) < 49.0  # of ten seconds


def test_a_session_is_killed_and_continued_to_its_end(tmp_path: Path) -> None:
    told = commanded(tmp_path, "continued", "1", "1", "9000")
    assert told["wrong"] == []
    assert told["readings"] == 2 * 6
    assert told["end"] == "closed"
