"""What ``identifiability`` and ``postures`` tell of a machine with three drives."""

from __future__ import annotations

from typing import Literal

from app.report.schema.document import (
    Count,
    Finite,
    Holes,
    Matrix,
    Numbers,
    Report,
    asked,
    at,
    schema,
)
from calib.design.criteria import Criterion


class Addition(Report):
    """The added posture that helps most, and the uncertainty then."""

    posture: str = at("where")
    standard_uncertainty_mm: float = at("standard_uncertainty")


class DirectionEntry(Report):
    """A combination of parameters that is lost or weak."""

    name: str
    combination: dict[str, float] = at("shares", "shares of the parameters")
    standard_uncertainty_mm: float | None = at("standard_uncertainty", "null where lost")
    tool_mm: float | None = at("tool_mm", "null where lost")
    cure: Addition | None = at("added")


class PosturesSeen(Report):
    """How many steps, and where they come from."""

    count: int = at("posture_count")
    source: str


class ClassicalQrEntry(Report):
    """The test of papers/001, in the order of the parameters."""

    tolerance: float
    flagged: tuple[str, ...]


class ExpectedEntry(Report):
    """Expanded uncertainty (95 %) to expect of a parameter; null where readings do not tell it."""

    name: str
    alone_mm: float | None = at("alone_mm", "offsets, or lengths, alone")
    all_mm: float | None = at("all_mm", "all six free")
    held_mm: float = at("held_mm", "all six, within the tolerances of the machine file")


class IdentifiabilityReport(Report):
    """``identifiability --json``: what a procedure can and cannot see."""

    schema_id: Literal["glidecal.identifiability/1"] = schema("glidecal.identifiability/1")
    machine: str = at("seen.machine")
    procedure: str = at("seen.examined.procedure")
    measured: tuple[str, ...] = at("seen.examined.measured", "axis_leg, or what else is read")
    postures: PosturesSeen = at("seen.examined")
    parameters: tuple[str, ...] = at("seen.found.names")
    rank: int = at("seen.found.rank")
    parameter_count: Count = at("seen.found.names")
    row_count: int = at("seen.found.row_count", "visits, or values")
    independent_row_count: int = at(
        "seen.examined.independent_count", "different postures less zeros, or values"
    )
    limited_by: Literal["nothing", "too-few-postures"] = at("seen.limited_by")
    fewest_postures: int | None = at("seen.examined.fewest_postures")
    published_rank: int | None = at(
        "seen.examined.published_rank", "of papers/001; null where it has none"
    )
    remark: str = at("seen.examined.remark")
    individually_identifiable: tuple[str, ...] = at("seen.found.individually_known")
    lost_directions: tuple[DirectionEntry, ...] = at("seen.unidentifiable")
    weak_directions: tuple[DirectionEntry, ...] = at("seen.weak")
    condition_number: Finite = at("seen.found.condition_number", "of the identifiable combinations")
    units: str = at("seen.examined.units")
    noise: str = at("seen.examined.noise_words")
    classical_qr: ClassicalQrEntry = at("seen.qr")
    expected: tuple[ExpectedEntry, ...] | None = asked("expected.parameters", "of tripods")
    expected_tool_bound_mm: float | None = asked(
        "expected.bound_mm", "joint offsets entered, touched off, if readings show nothing else"
    )


class PosturesReport(Report):
    """``postures --json``: optimum postures beside those of the procedure."""

    schema_id: Literal["glidecal.postures/1"] = schema("glidecal.postures/1")
    machine: str = at("chosen.machine")
    procedure: str = at("chosen.procedure")
    count: int = at("chosen.after.count")
    criterion: Criterion = at("chosen.criterion")
    value: float | None = at("chosen.after.value")
    procedure_value: float | None = at("chosen.before.value")
    grid_value: float | None = at(
        "chosen.grid_value", "before the postures left the grid; null with --no-refine"
    )
    condition_number: float | None = at("chosen.after.condition_number")
    start_condition_number: float | None = at(
        "chosen.start_condition_number",
        "of the random start that won; null where it did not see everything",
    )
    procedure_condition_number: float | None = at("chosen.before.condition_number")
    tool_mm: float | None = at("chosen.after.tool_mm")
    minutes: float = at("chosen.after.minutes")
    postures: tuple[dict[str, float | str], ...] = at(
        "chosen.postures", "leg, station, displacement_mm, approach"
    )
    coordinates_on_bound: int = at("chosen.coordinates_on_bound")
    exchanges: int = at("chosen.exchanges")
    seconds: float = at("chosen.seconds")
    starts: int = at("chosen.starts")
    seed: int = at("chosen.seed")


class Cube(Report):
    """The largest one found with every factor within the limit, inside the joint limits."""

    low_mm: Numbers
    side_mm: float


class FactorMap(Report):
    """On a plane through Zero; rows go up. The factor furthest from 1, or its inverse."""

    across: str
    up: str
    coordinate_mm: Numbers = at("coordinate_mm", "across")
    up_mm: Numbers = at("up_mm", "upwards")
    factor: Holes = at("value", "null where the tool does not reach")


class WorkspaceReport(Report):
    """``workspace --json``: where the tool can be, and how its drives move it there."""

    schema_id: Literal["glidecal.workspace/1"] = schema("glidecal.workspace/1")
    machine: str = at("machine.name")
    low_mm: Numbers = at("found.low_mm", "lowest corner of its box")
    high_mm: Numbers = at("found.high_mm")
    stated: bool = at("found.stated", "the box is workspace_mm of the machine file")
    reached: float = at("found.reached", "share of the box that joint limits and bars allow")
    volume_mm3: float = at("found.volume_mm3", "of that share")
    lowest_factor: float = at("found.lowest_factor", "velocity transmission, tool over carriages")
    highest_factor: float = at("found.highest_factor")
    factors_at_zero: Numbers = at("found.at_zero")
    limit: float = at("found.limit")
    within_limit: float = at("found.inside", "share of the workspace, factors 1/limit … limit")
    largest_cube: Cube | None = at("found.cube", "null: none")
    theta_deg: Matrix = at("found.theta_deg", "of legs x, y, z, lowest and highest; papers/000 (1)")
    beta_deg: Matrix = at("found.beta_deg")
    maps: tuple[FactorMap, ...] = at("found.maps")


class WorkingModeEntry(Report):
    """Signs in papers/000 (3), and the carriages from Zero that give the same tool."""

    signs: tuple[int, ...]
    carriage_mm: tuple[float, ...]


class PostureReport(Report):
    """``workspace --at --json``: one place of the tool."""

    schema_id: Literal["glidecal.posture/1"] = schema("glidecal.posture/1")
    machine: str = at("machine.name")
    tool_mm: tuple[float, float, float] = at("posture.tool_mm")
    stands: bool = at("posture.stands", "joint limits and bars allow it")
    theta_deg: Numbers = at("posture.theta_deg", "of legs x, y, z; papers/000 (1)")
    beta_deg: Numbers = at("posture.beta_deg")
    factors: Numbers = at("posture.factors", "velocity transmission, tool over carriages")
    working_modes: tuple[WorkingModeEntry, ...] = at("posture.modes", "the machine's own first")
    other_assembly_mm: Numbers = at("posture.assembly_mm", "where the same bars meet as well")
