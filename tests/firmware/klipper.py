"""Klipper's own kinematics of a delta, as its host program sets them up from ``printer.cfg``.

Nothing of it is kept in this repository and nothing is fetched: a checkout or bare git directory
``klipper`` lies where `tests.firmware.sources` looks for sources. Only `klippy/mathutil.py`,
`klippy/kinematics/delta.py` and `klippy/extras/delta_calibrate.py` are loaded; what moves motors is
replaced.
"""

from __future__ import annotations

import configparser
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from tests.firmware.sources import FOLDER, folder_of_sources

TURN_MM, STEPS_A_TURN = 40.0, 3200.0
STEP_MM = TURN_MM / STEPS_A_TURN
"""As the firmware holds it at first: a carriage travels so far for a step, but for its belt."""


def need_klipper() -> None:
    """Skip where its code is not to be had."""
    if not (folder_of_sources() / "klipper").is_dir():
        pytest.skip(
            "no sources of Klipper: put a checkout or bare git directory of Klipper3d/klipper as "
            f"klipper into {folder_of_sources()}, or into the folder that {FOLDER} names"
        )


class Section:
    """A section of a configuration as ``configfile.ConfigWrapper`` reads it."""

    def __init__(self, parser: configparser.RawConfigParser, name: str) -> None:
        self.parser, self.name = parser, name

    def getsection(self, name: str) -> Section:
        return Section(self.parser, name)

    def getfloat(self, option: str, default: Any = KeyError, **_: object) -> Any:  # noqa: ANN401 (the program's own default)
        if self.parser.has_option(self.name, option):
            return self.parser.getfloat(self.name, option)
        assert default is not KeyError, f"{option} must be specified in [{self.name}]"
        return default


class Rail:
    """A tower's motor: where its switch is, and how long a step is."""

    def __init__(
        self, section: Section, *, default_position_endstop: float | None = None, **_: object
    ) -> None:
        at = section.getfloat("position_endstop", default_position_endstop or KeyError)
        self.homing = SimpleNamespace(position_endstop=at)
        self.step_mm = section.getfloat("rotation_distance", TURN_MM) / STEPS_A_TURN

    def get_homing_info(self) -> SimpleNamespace:
        return self.homing

    def get_steppers(self) -> list[Any]:
        stepper = MagicMock()
        stepper.get_step_dist.return_value = self.step_mm
        return [stepper]

    def setup_itersolve(self, *_: object) -> None:
        pass

    def set_position(self, _: object) -> None:
        pass


@cache
def delta_module() -> ModuleType:
    """`klippy/kinematics/delta.py` with its own `mathutil`, and our `Rail` for its motors."""
    need_klipper()
    stepper = ModuleType("stepper")
    stepper.LookupMultiRail = Rail  # type: ignore[attr-defined]
    loaded = {"stepper": stepper, "queuelogger": ModuleType("queuelogger")}  # it logs elsewhere
    for name, path in (("mathutil", "mathutil.py"), ("delta", "kinematics/delta.py")):
        module = ModuleType(name)
        with pytest.MonkeyPatch.context() as patch:
            for module_name, replacement in loaded.items():
                patch.setitem(sys.modules, module_name, replacement)
            exec(compile(_source(path), path, "exec"), module.__dict__)
        loaded[name] = module
    return loaded["delta"]


def configuration_of(path: Path) -> configparser.RawConfigParser:
    """All values of a ``printer.cfg`` with includes and saved block, as Klipper reads them."""
    need_klipper()
    module = ModuleType("configfile")
    exec(compile(_source("configfile.py"), "configfile.py", "exec"), module.__dict__)
    host = MagicMock()
    host.get_start_args.return_value = {"config_file": str(path)}
    configuration, _ = module.ConfigAutoSave(host).load_main_config()
    assert isinstance(configuration, configparser.RawConfigParser)
    return configuration


def _source(path: str) -> bytes:
    source = folder_of_sources() / "klipper"
    if not (source / "HEAD").is_file():
        return (source / "klippy" / path).read_bytes()
    command = ("git", f"--git-dir={source}", "show", f"HEAD:klippy/{path}")
    return subprocess.run(command, check=True, capture_output=True).stdout


def kinematics_of(text: str) -> Any:  # noqa: ANN401 (a class of Klipper)
    """``DeltaKinematics`` of a ``printer.cfg``: of a key that is there twice the last counts."""
    module, parser = delta_module(), configparser.RawConfigParser(strict=False)
    parser.read_string(text)
    toolhead = MagicMock()
    toolhead.get_max_velocity.return_value = (300.0, 3000.0)
    toolhead.Coord = lambda *parts, **_: parts
    return module.DeltaKinematics(toolhead, Section(parser, "printer"))


def calibrated(text: str, places_mm: Sequence[Sequence[float]]) -> Any:  # noqa: ANN401 (as above)
    """`DELTA_CALIBRATE` of a ``printer.cfg`` after contacts at these places ``(n, 3)``, mm.

    Its fit is done here in place of a process of its own.
    """
    kinematics, mathutil = kinematics_of(text), delta_module().mathutil
    module, extras = ModuleType("extras.delta_calibrate"), ModuleType("extras")
    extras.probe = MagicMock()  # type: ignore[attr-defined]
    module.__package__ = "extras"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "extras", extras)
        patch.setitem(sys.modules, "mathutil", mathutil)
        exec(compile(_source("extras/delta_calibrate.py"), "delta_calibrate", "exec"), vars(module))
        patch.setattr(
            mathutil,
            "background_coordinate_descent",
            lambda _, *arguments: mathutil.coordinate_descent(*arguments),
        )
        calibrate = object.__new__(module.DeltaCalibrate)
        calibrate.printer, calibrate.gcode, calibrate.manual_heights = MagicMock(), MagicMock(), []
        calibrate.printer.lookup_object.return_value.get_kinematics.return_value = kinematics
        results: list[Any] = []
        calibrate.save_state = lambda _contacts, _distances, result: results.append(result)
        steps = kinematics.get_calibration().calc_stable_position
        calibrate.calculate_params([(0.0, steps(place)) for place in places_mm], [])
    return results[0]
