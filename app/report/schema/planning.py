"""What ``identifiability`` and ``postures`` tell of a machine with three drives."""

from __future__ import annotations

from typing import Literal

from app.report.schema.document import Holes, Matrix, Numbers, Report, Source, holes, maybe, schema
from app.report.schema.identifiability import SeenReport
from calib.design.criteria import Criterion
from calib.design.identifiability import SeenBy
from calib.posterior.expected import ExpectedParameter, ExpectedResult
from calib.tripod.optimum import ChosenPostures
from calib.tripod.workspace import LargestCube, PlaneMap, PostureOfTool, WorkingMode, Workspace
from protocols.machine import Machine


class IdentifiabilityReport(SeenReport):
    """``identifiability --json``: what a procedure sees of a machine of three drives."""

    of = Source[SeenBy, ExpectedResult]()
    expected: tuple[ExpectedParameter, ...] | None = of(lambda _, r: r.parameters, asked=True)
    """of tripods"""
    expected_tool_bound_mm: float | None = of(lambda _, r: r.bound_mm, asked=True)
    """joint offsets entered, workpiece touched off, if readings show nothing else"""


class PosturesReport(Report):
    """``postures --json``: optimum postures beside those of the procedure."""

    of = Source[ChosenPostures]()
    schema_id: Literal["glidecal.postures/1"] = schema("glidecal.postures/1")
    machine: str = of(lambda r: r.machine)
    procedure: str = of(lambda r: r.procedure)
    count: int = of(lambda r: r.after.count)
    criterion: Criterion = of(lambda r: r.criterion)
    value: float | None = of(lambda r: r.after.value)
    procedure_value: float | None = of(lambda r: r.before.value)
    grid_value: float | None = of(lambda r: r.grid_value)
    """before the postures left the grid; null with --no-refine"""
    condition_number: float | None = of(lambda r: r.after.condition_number)
    start_condition_number: float | None = of(lambda r: r.start_condition_number)
    """of the random start that won; null where it did not see everything"""
    procedure_condition_number: float | None = of(lambda r: r.before.condition_number)
    tool_mm: float | None = of(lambda r: r.after.tool_mm)
    minutes: float = of(lambda r: r.after.minutes)
    postures: tuple[dict[str, float | str], ...] = of(lambda r: r.postures)
    """leg, station, displacement_mm, approach"""
    coordinates_on_bound: int = of(lambda r: r.coordinates_on_bound)
    exchanges: int = of(lambda r: r.exchanges)
    seconds: float = of(lambda r: r.seconds)
    starts: int = of(lambda r: r.starts)
    seed: int = of(lambda r: r.seed)


class Cube(Report):
    """The largest one found with every factor within the limit, inside the joint limits."""

    of = Source[LargestCube]()
    low_mm: Numbers = of(lambda r: r.low_mm.tolist())
    side_mm: float = of(lambda r: r.side_mm)


class FactorMap(Report):
    """Factors on a plane through Zero; rows go up. The factor furthest from 1, or its inverse."""

    of = Source[PlaneMap]()
    across: str = of(lambda r: r.across)
    up: str = of(lambda r: r.up)
    coordinate_mm: Numbers = of(lambda r: r.coordinate_mm.tolist())
    """across"""
    up_mm: Numbers = of(lambda r: r.up_mm.tolist())
    """upwards"""
    factor: Holes = of(lambda r: holes(r.value))
    """null where the tool does not reach"""


class WorkspaceReport(Report):
    """``workspace --json``: where the tool can be, and how its drives move it there."""

    of = Source[Machine, Workspace]()
    schema_id: Literal["glidecal.workspace/1"] = schema("glidecal.workspace/1")
    machine: str = of(lambda machine, _: machine.name)
    low_mm: Numbers = of(lambda _, r: r.low_mm.tolist())
    """lowest corner of its box"""
    high_mm: Numbers = of(lambda _, r: r.high_mm.tolist())
    stated: bool = of(lambda _, r: r.stated)
    """the box is workspace_mm of the machine file"""
    reached: float = of(lambda _, r: r.reached)
    """share of the box that joint limits and bars allow"""
    volume_mm3: float = of(lambda _, r: r.volume_mm3)
    """of that share"""
    lowest_factor: float = of(lambda _, r: r.lowest_factor)
    """velocity transmission, tool over carriages"""
    highest_factor: float = of(lambda _, r: r.highest_factor)
    factors_at_zero: Numbers = of(lambda _, r: r.at_zero.tolist())
    limit: float = of(lambda _, r: r.limit)
    within_limit: float = of(lambda _, r: r.inside)
    """share of the workspace, factors 1/limit … limit"""
    largest_cube: Cube | None = of(lambda _, r: maybe(Cube.of, r.cube))
    """null: none"""
    theta_deg: Matrix = of(lambda _, r: r.theta_deg.tolist())
    """of legs x, y, z, lowest and highest; papers/000 (1)"""
    beta_deg: Matrix = of(lambda _, r: r.beta_deg.tolist())
    maps: tuple[FactorMap, ...] = of(lambda _, r: tuple(map(FactorMap.of, r.maps)))


class PostureReport(Report):
    """``workspace --at --json``: one place of the tool."""

    of = Source[Machine, PostureOfTool]()
    schema_id: Literal["glidecal.posture/1"] = schema("glidecal.posture/1")
    machine: str = of(lambda machine, _: machine.name)
    tool_mm: tuple[float, float, float] = of(lambda _, r: r.tool_mm)
    stands: bool = of(lambda _, r: r.stands)
    """joint limits and bars allow it"""
    theta_deg: Numbers = of(lambda _, r: r.theta_deg.tolist())
    """of legs x, y, z; papers/000 (1)"""
    beta_deg: Numbers = of(lambda _, r: r.beta_deg.tolist())
    factors: Numbers = of(lambda _, r: r.factors.tolist())
    """velocity transmission, tool over carriages"""
    working_modes: tuple[WorkingMode, ...] = of(lambda _, r: r.modes)
    """the machine's own first"""
    other_assembly_mm: Numbers = of(lambda _, r: r.assembly_mm.tolist())
    """where the same bars meet as well"""
