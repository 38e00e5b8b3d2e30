"""Printers of upright towers whose parts are off, and the firmware that drives them.

The machine is written here from the geometry, the firmware from the documented formulas: Klipper's
klippy/kinematics/delta.py, RepRapFirmware's LinearDeltaKinematics.cpp, Marlin's module/delta.cpp
and homeaxis(), Smoothieware's LinearDeltaSolution.cpp and Endstops.cpp, LinuxCNC's
lineardeltakins-common.h. Nothing of the program's mathematics takes part.
"""

from __future__ import annotations

import configparser
import csv
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calib.tripod.effects.drives import ActuatorScale, AxisOffset, AxisSquareness
from calib.tripod.effects.effect import EffectInstance
from calib.tripod.pipeline import Model
from protocols.machine import Machine, load_machine
from protocols.machine_files import MACHINES
from protocols.model_file import model_file
from tests.app.cli import glidecal
from tests.blind.linear_delta import places

FloatArray = NDArray[np.float64]
Firmware = Callable[[FloatArray], FloatArray]
"""Travel below each switch ``(3,)``, towers x, y, z, for a tool that is sent there."""

BAR, RADIUS = 250.0, 124.0
ANGLES = np.array([210.0, 330.0, 90.0])
ENDSTOPS = (300.1, 299.9, 300.4)
TURN_MM, STEPS = 40.0, 80.0
"""Held by the firmware for the travel of every tower before anything is entered."""
GRID = [
    np.array([x, y, z])
    for x in np.linspace(-50.0, 50.0, 6)
    for y in np.linspace(-50.0, 50.0, 6)
    for z in 100.0 / 6.0 + np.linspace(0.0, 1000.0 / 6.0, 6)
]
"""Middles of 6 × 6 × 6 cells of the workspace of the machine file."""


def outward(angles_deg: FloatArray) -> FloatArray:
    return np.stack([np.cos(np.radians(angles_deg)), np.sin(np.radians(angles_deg))], axis=1)


@dataclass(frozen=True)
class Hidden:
    """What is off: switches and bars of towers x, y, z, towers outwards and anticlockwise."""

    switch_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bar_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    out_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    round_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lean_xy: float = 0.0  # rad, towers x and y together, half each, with their coordinate
    stretch: tuple[float, float, float] = (0.0, 0.0, 0.0)  # mm/mm, travel below each switch
    wrong_sign: bool = field(default=False)

    def tool(self, travel_mm: FloatArray) -> FloatArray:
        """Where three spheres meet ``(..., 3)``, by Newton's method."""
        height_mm = np.array(ENDSTOPS) + math.sqrt(BAR**2 - RADIUS**2)
        height = height_mm + self.switch_mm - (1.0 + np.array(self.stretch)) * travel_mm
        out = outward(ANGLES)
        across = np.stack([-out[:, 1], out[:, 0]], axis=1)
        feet = (RADIUS + np.array(self.out_mm))[:, None] * out
        feet = feet + np.array(self.round_mm)[:, None] * across
        apart = (out[1] - out[0]) / np.linalg.norm(out[1] - out[0])
        lean = self.lean_xy / 2.0 * np.stack([apart, -apart, 0.0 * apart])
        foot = np.concatenate([feet + height[..., None] * lean, height[..., None]], axis=-1)
        place = np.zeros_like(height)
        place[..., 2] = height.mean(axis=-1) - 217.0
        for _ in range(30):
            bars = place[..., None, :] - foot
            residual = (bars**2).sum(axis=-1) - (BAR + np.array(self.bar_mm)) ** 2
            step = np.linalg.solve(2.0 * bars, residual[..., None])[..., 0]
            place = place - step
            if np.abs(step).max() < 1e-11:
                break
        return place

    def model(self) -> Model:
        """The same for the program, as docs/effects.md states the signs."""
        effects = [
            EffectInstance(AxisOffset(), f"{leg}{way}", (value,))
            for way, values in (("r", self.out_mm), ("t", self.round_mm))
            for leg, value in zip("xyz", values, strict=True)
            if value
        ]
        if self.lean_xy:
            effects.append(EffectInstance(AxisSquareness(), "xy", (1e3 * self.lean_xy,)))
        sign = -1.0 if self.wrong_sign else 1.0
        effects += [
            EffectInstance(ActuatorScale(), leg, (1e3 * sign * part,))
            for leg, part in zip("xyz", self.stretch, strict=True)
            if part
        ]
        # scale of the program counts from Zero, where the carriage is this far below its switch
        switches = np.array(self.switch_mm) - np.array(self.stretch) * ENDSTOPS
        values = tuple(sign * value for value in (*switches.tolist(), *self.bar_mm))
        return Model(machine().geometry(), values, tuple(effects))


def machine(**changes: object) -> Machine:
    """The linear delta that comes with the program, its rounded places written out in full."""
    shipped = load_machine("linear-delta")
    assert shipped.drive is not None
    drives = [
        drive.model_copy(
            update={"origin_mm": (*(157.0 * o), 0.0), "platform_mm": (*(33.0 * o), 0.0)}
        )
        for drive, o in zip(shipped.drive, outward(ANGLES).tolist(), strict=True)
        for o in [np.array(o)]
    ]
    fields = {
        "drive": tuple(drives),
        "position_endstop_mm": ENDSTOPS,
        "rotation_distance_mm": (TURN_MM,) * 3,
        "steps_per_mm": (STEPS,) * 3,
    }
    return shipped.model_copy(update=fields | changes)


def errors(hidden: Hidden, firmware: Firmware) -> FloatArray:
    """Tool less where it was sent, less the same in the middle of the plate ``(n, 3)``."""
    zero = hidden.tool(firmware(np.zeros(3)))
    travel_mm = np.array([firmware(place) for place in GRID])
    return np.asarray(hidden.tool(travel_mm) - GRID - zero)


def rms(errors_mm: FloatArray) -> float:
    return math.sqrt(float((errors_mm**2).sum(axis=1).mean()))


def carriages(place: FloatArray, arms: FloatArray, towers: FloatArray) -> FloatArray:
    return np.asarray(place[2] + np.sqrt(arms**2 - ((place[:2] - towers) ** 2).sum(axis=1)))


def klipper(text: str) -> Firmware:
    config = configparser.RawConfigParser()
    config.read_string(text)
    radius = config.getfloat("printer", "delta_radius")
    rows = [
        [config.getfloat(f"stepper_{n}", key) for n in "abc"]
        for key in ("position_endstop", "arm_length", "angle")
    ]
    endstops, arms, angles = (np.array(row) for row in rows)
    trip = endstops + np.sqrt(arms**2 - radius**2)
    # a motor turns for its rotation_distance: then the carriage travels as at first for TURN_MM
    turns = [config.getfloat(f"stepper_{n}", "rotation_distance", fallback=TURN_MM) for n in "abc"]
    step = TURN_MM / np.array(turns)
    return lambda place: step * (trip - carriages(place, arms, radius * outward(angles)))


def words(line: str) -> dict[str, str]:
    return {word[0]: word[1:] for word in line.split()[1:]}


def step(text: str) -> FloatArray:
    """How far a carriage travels, as at first, for a commanded mm: by steps per mm, where stated.

    In all of these firmwares M92 X Y Z are those of the motors of the towers.
    """
    commands = [words(line) for line in text.splitlines() if line.startswith("M92")]
    return np.array([float(commands[-1][name]) / STEPS if commands else 1.0 for name in "XYZ"])


def reprapfirmware(text: str) -> Firmware:
    """Recalc() and Transform(), in double precision."""
    (geometry,) = [words(line) for line in text.splitlines() if line.startswith("M665")]
    (switches,) = [words(line) for line in text.splitlines() if line.startswith("M666")]
    arms = np.array([float(part) for part in geometry["L"].split(":")])
    radius, height = float(geometry["R"]), float(geometry["H"])
    a, b, c = (float(geometry[name]) for name in "XYZ")
    rad = math.radians
    towers = radius * np.array(
        [
            [-math.cos(rad(30 + a)), -math.sin(rad(30 + a))],
            [+math.cos(rad(30 - b)), -math.sin(rad(30 - b))],
            [-math.sin(rad(c)), +math.cos(rad(c))],
        ]
    )
    trip = height + np.sqrt(arms**2 - radius**2) + [float(switches[n]) for n in "XYZ"]
    assert sum(float(switches[n]) for n in "XYZ") == pytest.approx(0.0, abs=2e-6)
    return lambda place: step(text) * (trip - carriages(place, arms, towers))


def all_words(text: str, command: str) -> dict[str, float]:
    """Words of all lines with this command: each sets what it names."""
    lines = [line for line in text.splitlines() if line.startswith(command)]
    assert all(len(line) <= 96 for line in lines), "Marlin cuts longer lines"
    return {name: float(value) for line in lines for name, value in words(line).items()}


def marlin(text: str) -> Firmware:
    """recalc_delta_settings(), DELTA_IK, and homing that retraces by M666 and is then at H."""
    settings, trims = all_words(text, "M665"), all_words(text, "M666")
    arms = settings["L"] + np.array([settings[name] for name in "ABC"])
    angles = np.array([210.0, 330.0, 90.0]) + [settings[name] for name in "XYZ"]
    towers = settings["R"] * outward(angles)
    retraced = np.array([trims[name] for name in "XYZ"])
    assert (retraced <= -0.2).all(), "above 0 is refused, near 0 no step is made"
    at_home = carriages(np.array([0.0, 0.0, settings["H"]]), arms, towers)
    return lambda place: step(text) * (at_home - carriages(place, arms, towers) - retraced)


def smoothieware(text: str) -> Firmware:
    """init(), cartesian_to_actuator(), and homing that believes to be M666 below Z."""
    settings, trims = all_words(text, "M665"), all_words(text, "M666")
    angles = np.array([210.0, 330.0, 90.0]) + [settings[name] for name in "DEH"]
    radii = settings["R"] + np.array([settings[name] for name in "ABC"])
    towers, arms = radii[:, None] * outward(angles), np.full(3, settings["L"])
    trim = np.array([trims[name] for name in "XYZ"])
    at_switch = carriages(np.array([0.0, 0.0, settings["Z"]]), arms, towers) - trim
    return lambda place: step(text) * (at_switch - carriages(place, arms, towers))


def p_3z(text: str) -> Firmware:
    """A carriage at z + sqrt(L^2 - (x - rail x)^2 - (y - rail y)^2), each axis from its switch."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    values = {row["parameter"]: float(row["value"]) for row in csv.DictReader(lines)}
    assert values["TCP displacement"] == 0.0
    towers = np.array([[values[f"Rail {n} {way}-position"] for way in "XY"] for n in (1, 2, 3)])
    change = [values[f"axis {n} position at homing, change"] for n in (1, 2, 3)]
    homes = np.array(ENDSTOPS) + math.sqrt(BAR**2 - RADIUS**2) + change
    return lambda place: homes - carriages(place, np.full(3, values["Arm length"]), towers)


def lineardeltakins(folder: Path) -> Firmware:
    """kinematics_inverse(); joints 0, 1, 2 are towers z, x, y here."""
    pins = dict(
        re.findall(
            r"^setp lineardeltakins\.([LR]) (\S+)$", (folder / "calib.hal").read_text(), re.M
        )
    )
    length, radius = float(pins["L"]), float(pins["R"])
    half = math.sqrt(3.0) / 2.0
    towers = radius * np.array([[0.0, 1.0], [-half, -0.5], [half, -0.5]])
    homes = [
        float(
            re.findall(
                r"^HOME_OFFSET = (\S+)$", (folder / f"calib_joint{n}.inc").read_text(), re.M
            )[0]
        )
        for n in range(3)
    ]
    return lambda place: (homes - carriages(place, np.full(3, length), towers))[[1, 2, 0]]


BELIEVED = klipper(
    f"[printer]\ndelta_radius: {RADIUS}\n"
    + "".join(
        f"[stepper_{n}]\nposition_endstop: {stop}\narm_length: {BAR}\nangle: {angle}\n"
        for n, stop, angle in zip("abc", ENDSTOPS, ANGLES, strict=True)
    )
)


def exported(hidden: Hidden, kind: str, folder: Path, *options: str, **changes: object) -> Path:
    folder.mkdir(exist_ok=True)
    model, out = folder / "model.json", folder / kind
    model.write_text(model_file(hidden.model(), machine(**changes)).text(), encoding="utf-8")
    run = glidecal("export", model, "--format", kind, "-o", out, *options)
    assert run.status == 0, run.err
    return out


def comments(text: str) -> str:
    return " ".join(line.lstrip("#; ") for line in text.splitlines() if line[:1] in ("#", ";"))


ANYTHING = Hidden(
    (1.0, -0.6, 0.3), (0.3, -0.2, 0.15), out_mm=(0.4, -0.3, 0.6), round_mm=(0.5, 0.2, -0.4)
)
READ = {"klipper": klipper, "reprapfirmware": reprapfirmware, "marlin": marlin}
"""Firmware with a length for each bar."""

READ_ALIKE = {"smoothieware": smoothieware, "p-3z": p_3z}
"""Controllers with one length, and towers anywhere."""

READ_ANY = READ | READ_ALIKE

STRETCHED = Hidden(
    (1.0, -0.6, 0.3), (0.3, -0.2, 0.15), out_mm=(0.4, 0.3, -0.2), stretch=(5e-3, -3e-3, 1e-3)
)
"""Belts of which one travels too far, one too short."""

OFF_IN_ALL = Hidden(
    (0.4, -0.3, 0.2),
    (0.5, 0.45, 0.55),
    out_mm=(0.7, 0.3, 0.5),
    round_mm=(0.3, -0.4, 0.2),
)
"""Switches, bars, the radius and the angles of the towers are off."""


def read_over_the_plate(hidden: Hidden, folder: Path, seed: int = 1) -> Path:
    """A session of an indicator at the tool over a flat plate, three cycles of rings."""
    generator = np.random.default_rng(seed)
    middle = hidden.tool(BELIEVED(np.zeros(3)))[2]
    rows = ["x_mm,y_mm,z_mm,value_mm,cycle"]
    for cycle, place in [*places(), (3, np.zeros(3))]:
        reading = hidden.tool(BELIEVED(place))[2] - middle + generator.normal(scale=0.002)
        rows.append(f"{place[0]:.3f},{place[1]:.3f},0,{reading:.3f},{cycle}")
    machine_path, source, session = folder / "m.toml", folder / "plate.csv", folder / "plate.jsonl"
    machine_path.write_text(machine_toml(), encoding="utf-8")
    source.write_text("\n".join(rows) + "\n", encoding="utf-8")
    run = glidecal(
        "import", source, "-o", session, "--machine", machine_path, "--resolution", "0.001"
    )
    assert run.status == 0, run.err
    return session


def machine_toml() -> str:
    """The machine file that comes with the program, with the switches' present heights."""
    text = (MACHINES / "linear-delta.toml").read_text(encoding="utf-8")
    stated = f"position_endstop_mm = {list(ENDSTOPS)}"
    toml, count = re.subn(r"(?m)^# position_endstop_mm = .*$", stated, text)
    assert count == 1
    return toml
