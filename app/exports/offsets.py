"""What is exported: identified parameters of one machine and where they come from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from app.own_effects import known_laws
from app.solving import Solved, solve_files
from calib.orthoglide.geometry import PARAMETER_NAMES
from calib.solution import Method, Subset
from protocols.documents import read_text
from protocols.machine import Machine
from protocols.model_file import is_model, read_model

Written = dict[str, str]


@dataclass(frozen=True)
class Offsets:
    """Parameters in mm with standard uncertainties (None where the source has none).

    ``home_offset_mm`` are the controller's present values, None where nobody stated them.
    """

    source: str
    machine: Machine
    values_mm: dict[str, float]
    standard_uncertainty_mm: dict[str, float | None]
    home_offset_mm: tuple[float, float, float] | None
    remarks: tuple[str, ...] = ()

    @property
    def joint_offsets_mm(self) -> tuple[float, float, float]:
        """d_rho of joints x, y, z: true position = believed position + offset."""
        x, y, z = (self.values_mm.get(name, 0.0) for name in PARAMETER_NAMES[:3])
        return x, y, z

    @property
    def lengths_mm(self) -> dict[str, float]:
        """The leg length errors that are not zero."""
        names = PARAMETER_NAMES[3:]
        return {name: self.values_mm[name] for name in names if self.values_mm.get(name)}


def offsets_from_solved(solved: Solved) -> Offsets:
    """Offsets of a solution."""
    solution = solved.solution
    machine = solved.sessions[0].opened.machine
    uncertainty = solution.uncertainty_mm
    remarks = []
    if solution.subset != solved.choice.recommended:
        remarks.append(
            f"exported set: {solution.subset}; recommended: {solved.choice.recommended} "
            f"({solved.choice.reasons[0]})"
        )
    return Offsets(
        source=", ".join(solved.names),
        machine=machine,
        values_mm=dict(zip(solution.names, map(float, solution.values_mm), strict=True)),
        standard_uncertainty_mm=dict(zip(solution.names, map(float, uncertainty), strict=True)),
        home_offset_mm=machine.home_offset_mm,
        remarks=tuple(remarks),
    )


def offsets_from_file(path: Path, subset: Subset, method: Method) -> tuple[Offsets, list[str]]:
    """Offsets of a session or a model file, with warnings.

    Raises RecordError where the file is neither, NotIdentifiable where it gives no result.
    """
    if is_model(read_text(path, "file")):
        model, machine = read_model(path, known_laws())
        values = dict(zip(PARAMETER_NAMES, model.parameters_mm, strict=True))
        none: dict[str, float | None] = dict.fromkeys(values)
        return Offsets(path.name, machine, values, none, machine.home_offset_mm), []
    solved, warnings = solve_files([path], subset=subset, method=method)
    return offsets_from_solved(solved), warnings


def with_home_offset(offsets: Offsets, home_offset_mm: tuple[float, float, float]) -> Offsets:
    """The same offsets for a controller that now holds these HOME_OFFSET values."""
    return replace(offsets, home_offset_mm=home_offset_mm)
