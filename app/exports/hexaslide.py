"""A calibrated Hexa Slide for programs: machine file, postures to command, kinematics of LinuxCNC.

LinuxCNC's own ``genhexkins`` cannot hold its rails: its joints are lengths of struts between fixed
ends. Telescopic legs are such struts.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import resources
from pathlib import Path

from app.evaluating.hexaslide_calibration import CalibratedMachine
from app.exports.linuxcnc import short_lines
from app.planning.hexaslide import inside_box, posture_table, table
from app.report.schema.hexaslide import HexaSlideCalibrationReport
from app.report.text.hexaslide_calibration import caveats
from calib.hexaslide.calibration import corrected
from calib.hexaslide.geometry import HexaSlide
from protocols.files import Contents, write_files
from protocols.hexaslide import (
    CALIBRATED,
    HexaSlideMachine,
    load_postures,
    machine_like,
    machine_text,
)

MODULE, OF_STRUTS = "hexaslidekins", "genhexkins"

NOT_GENHEXKINS = (
    "not for LinuxCNC's genhexkins: its struts change their length between fixed ends, these links "
    f"keep theirs while their carriages move; {MODULE}.comp is for them"
)
OF_GENHEXKINS = (
    f"calib.hal is for LinuxCNC's {OF_STRUTS}; its joints are whole lengths of legs, so HOME and "
    "HOME_OFFSET are readings of the drives plus the lengths in its comments, and its A, B, C are "
    "other angles than psi, theta, phi"
)
TURNS = (
    "A, B, C turn about the fixed X, then Y, then Z: Rz(C) Ry(B) Rx(A). The postures of glidecal "
    "are Ry(theta) Rx(psi) Rz(phi): the same orientation has other angles there, A is not psi."
)


def calibrated_files(result: CalibratedMachine, to_command: Path | None) -> Contents:
    """``machine.toml``, ``hexaslidekins.comp`` with ``calib.hal``, of telescopic legs that alone,
    for ``genhexkins``; for a file of postures ``to_command`` also ``postures.csv``, to be commanded
    instead of them, and ``sliders.csv``.

    Raises RecordError for that file, CalibrationError for postures that cannot be reached.
    """
    head, file = _head(result), calibrated_machine(result)
    calibrated, source_machine = result.entered, result.source.machine
    telescopic = calibrated.geometry.telescopic
    files = {"machine.toml": machine_text(file, head)}
    if not telescopic:
        source = resources.files("app.exports").joinpath(f"{MODULE}.comp")
        files[f"{MODULE}.comp"] = source.read_text(encoding="utf-8")
    values = strut_pins(calibrated) if telescopic else pins(calibrated)
    files["calib.hal"] = "".join(f"# {line}\n" for line in [*head, "Millimetres."]) + values
    if to_command is None:
        return files
    nominal = source_machine.whole()
    commands, sliders = corrected(
        nominal, calibrated, inside_box(load_postures(to_command), nominal)
    )
    names = [f"slider{chain}_m" for chain in range(1, sliders.shape[1] + 1)]
    moved = {"postures.csv": posture_table(commands), "sliders.csv": table(names, sliders.tolist())}
    return {**files, **moved}


def calibrated_machine(result: CalibratedMachine) -> HexaSlideMachine:
    """The machine file with the calibrated values."""
    source = result.source.machine
    return machine_like(source, f"{source.before_calibration}{CALIBRATED}", result.entered)


def _head(result: CalibratedMachine) -> list[str]:
    """Where the values are from and what stands against them, in short lines."""
    document = HexaSlideCalibrationReport.of(result)
    head = [
        f"Calibrated from {document.measurements}, {document.procedure.value}: {document.rank} of "
        f"{document.parameter_count} combinations identified."
    ]
    return [line for text in [*head, *caveats(document)] for line in short_lines(text)]


def ros2_parameters(result: CalibratedMachine) -> str:
    """The calibrated machine as a file of parameters for a node of ROS 2, metres.

    Its arrays have one dimension there, so each chain has a table of its own. No URDF holds such
    a machine: its links are a tree, and these chains close.
    """
    machine, bound_m = calibrated_machine(result), result.platform.bound_m
    telescopic = result.entered.geometry.telescopic
    lines = [
        *(f"# {line}" for line in _head(result)),
        "# Lengths in metres.",
        "/**:",
        "  ros__parameters:",
        "    calibrated_kinematics:",
        f"      machine: {json.dumps(machine.name)}",  # a text of JSON is one of YAML
        f"      legs: {'telescopic' if telescopic else 'carriages on rails'}",
        f"      not_identifiable: {json.dumps(result.fit.unidentifiable or [''])}",
    ]
    if bound_m is not None:
        lines.append(f"      platform_error_bound: {_yaml([bound_m])}")
    for number, chain in enumerate(machine.chain, start=1):
        lines += [
            f"      chain{number}:",
            f"        start: [{_yaml(mm / 1000.0 for mm in chain.start_mm)}]",
            *([f"        rail: [{_yaml(chain.rail)}]"] if chain.rail else []),
            f"        joint: [{_yaml(mm / 1000.0 for mm in chain.joint_mm)}]",
            f"        link: {_yaml([chain.link_mm / 1000.0])}",
        ]
    return "\n".join(lines) + "\n"


def _yaml(values: Iterable[float]) -> str:
    """Always with a point and no exponent: YAML 1.1 takes 1e-05 for a text."""
    return ", ".join(f"{round(value, 12) + 0.0:.12f}" for value in values)


def strut_pins(machine: HexaSlide) -> str:
    """``setp`` lines for ``genhexkins``, whose joints are whole lengths of legs, millimetres."""
    geometry = machine.geometry
    lengths = enumerate((1000.0 * geometry.links).tolist())
    lines = [f"# Joint {k} = reading of its drive + {mm:.6f}" for k, mm in lengths]
    lines += [f"# {line}" for line in short_lines(TURNS)]
    for name, points in (("base", geometry.base), ("platform", geometry.platform)):
        for leg, point in enumerate((1000.0 * points).tolist()):
            lines += [
                f"setp {OF_STRUTS}.{name}.{leg}.{axis} {mm:.15g}"
                for axis, mm in zip("xyz", point, strict=True)
            ]
    return "\n".join(lines) + "\n"


def kinematics_words(machine: HexaSlide) -> str:
    """Which module of LinuxCNC holds the machine."""
    return OF_GENHEXKINS if machine.geometry.telescopic else NOT_GENHEXKINS


def write_calibrated(result: CalibratedMachine, folder: Path, *, replace: bool) -> list[Path]:
    """The files of `calibrated_files` in a folder. Raises as `write_files`."""
    return write_files(folder, calibrated_files(result, None), replace=replace)


def pins(machine: HexaSlide) -> str:
    """``setp`` lines for the kinematics, millimetres and degrees."""
    geometry = machine.geometry
    values: dict[str, float] = {}
    for name, vectors, unit in (
        ("start", geometry.base, 1000.0),
        ("rail", geometry.rails, 1.0),
        ("joint", geometry.platform, 1000.0),
    ):
        for chain, vector in enumerate(vectors.tolist()):
            parts = zip("xyz", vector, strict=True)
            values |= {f"{name}-{chain}-{axis}": unit * part for axis, part in parts}
    values |= {f"link-{chain}": 1000.0 * v for chain, v in enumerate(geometry.links.tolist())}
    x, y, z, theta, psi, phi = machine.box.centre_mm_deg
    values |= {f"centre-{k}": v for k, v in enumerate((x, y, z, psi, theta, phi))}
    return "".join(f"setp {MODULE}.{pin} {value:.15g}\n" for pin, value in values.items())
