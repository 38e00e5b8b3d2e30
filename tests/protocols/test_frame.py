"""How a workpiece is set: a key of the machine file, in the words of the posterior."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import pytest

from calib.errors import RecordError
from calib.posterior.tool import FRAMES
from protocols.machine import Frame, load_machine

HEAD = 'schema = "glidecal.machine/1"\n'


def test_the_frames_of_a_machine_file_are_those_of_the_posterior() -> None:
    assert get_args(Frame) == FRAMES


@pytest.mark.parametrize("frame", get_args(Frame))
def test_a_machine_file_states_the_frame(tmp_path: Path, frame: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(f'{HEAD}frame = "{frame}"\n')
    assert load_machine(path).frame == frame


def test_a_workpiece_is_touched_off_where_nothing_is_stated() -> None:
    assert load_machine(None).frame == "touched-off"


def test_another_frame_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.toml"
    path.write_text(f'{HEAD}frame = "free"\n')
    with pytest.raises(RecordError, match="touched-off"):
        load_machine(path)
