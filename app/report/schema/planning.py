"""What ``identifiability`` and ``postures`` tell of a machine with three drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from app.report.schema.document import (
    Holes,
    Matrix,
    Numbers,
    Report,
    Source,
    holes,
    maybe,
    schema,
)
from app.report.schema.identifiability import SeenReport
from calib.design.criteria import Criterion
from calib.design.identifiability import SeenBy
from calib.posterior.expected import ExpectedParameter, ExpectedResult
from calib.tripod.optimum import ChosenPostures
from calib.tripod.workspace import LargestCube, PlaneMap, PostureOfTool, WorkingMode, Workspace
from protocols.machine import Machine


@dataclass(frozen=True, eq=False)
class IdentifiabilityResults:
    """What a procedure sees, and what is to be expected of it."""

    seen: SeenBy
    expected: ExpectedResult


class IdentifiabilityReport(SeenReport):
    """``identifiability --json``: what a procedure sees of a machine of three drives."""

    of = Source[IdentifiabilityResults]()
    expected: tuple[ExpectedParameter, ...] | None = of(
        lambda result: result.expected.parameters,
        "of tripods",
        asked=True,
    )
    expected_tool_bound_mm: float | None = of(
        lambda result: result.expected.bound_mm,
        "joint offsets entered, touched off, if readings show nothing else",
        asked=True,
    )


class PosturesReport(Report):
    """``postures --json``: optimum postures beside those of the procedure."""

    of = Source[ChosenPostures]()
    schema_id: Literal["glidecal.postures/1"] = schema("glidecal.postures/1")
    machine: str = of(lambda chosen: chosen.machine)
    procedure: str = of(lambda chosen: chosen.procedure)
    count: int = of(lambda chosen: chosen.after.count)
    criterion: Criterion = of(lambda chosen: chosen.criterion)
    value: float | None = of(lambda chosen: chosen.after.value)
    procedure_value: float | None = of(lambda chosen: chosen.before.value)
    grid_value: float | None = of(
        lambda chosen: chosen.grid_value, "before the postures left the grid; null with --no-refine"
    )
    condition_number: float | None = of(lambda chosen: chosen.after.condition_number)
    start_condition_number: float | None = of(
        lambda chosen: chosen.start_condition_number,
        "of the random start that won; null where it did not see everything",
    )
    procedure_condition_number: float | None = of(lambda chosen: chosen.before.condition_number)
    tool_mm: float | None = of(lambda chosen: chosen.after.tool_mm)
    minutes: float = of(lambda chosen: chosen.after.minutes)
    postures: tuple[dict[str, float | str], ...] = of(
        lambda chosen: chosen.postures, "leg, station, displacement_mm, approach"
    )
    coordinates_on_bound: int = of(lambda chosen: chosen.coordinates_on_bound)
    exchanges: int = of(lambda chosen: chosen.exchanges)
    seconds: float = of(lambda chosen: chosen.seconds)
    starts: int = of(lambda chosen: chosen.starts)
    seed: int = of(lambda chosen: chosen.seed)


class Cube(Report):
    """The largest one found with every factor within the limit, inside the joint limits."""

    of = Source[LargestCube]()
    low_mm: Numbers = of(lambda cube: cube.low_mm.tolist())
    side_mm: float = of(lambda cube: cube.side_mm)


class FactorMap(Report):
    """On a plane through Zero; rows go up. The factor furthest from 1, or its inverse."""

    of = Source[PlaneMap]()
    across: str = of(lambda plane: plane.across)
    up: str = of(lambda plane: plane.up)
    coordinate_mm: Numbers = of(lambda plane: plane.coordinate_mm.tolist(), "across")
    up_mm: Numbers = of(lambda plane: plane.up_mm.tolist(), "upwards")
    factor: Holes = of(lambda plane: holes(plane.value), "null where the tool does not reach")


@dataclass(frozen=True, eq=False)
class WorkspaceResults:
    """The workspace of a machine."""

    machine: Machine
    workspace: Workspace


class WorkspaceReport(Report):
    """``workspace --json``: where the tool can be, and how its drives move it there."""

    of = Source[WorkspaceResults]()
    schema_id: Literal["glidecal.workspace/1"] = schema("glidecal.workspace/1")
    machine: str = of(lambda result: result.machine.name)
    low_mm: Numbers = of(
        lambda result: result.workspace.low_mm.tolist(), "lowest corner of its box"
    )
    high_mm: Numbers = of(lambda result: result.workspace.high_mm.tolist())
    stated: bool = of(
        lambda result: result.workspace.stated, "the box is workspace_mm of the machine file"
    )
    reached: float = of(
        lambda result: result.workspace.reached,
        "share of the box that joint limits and bars allow",
    )
    volume_mm3: float = of(lambda result: result.workspace.volume_mm3, "of that share")
    lowest_factor: float = of(
        lambda result: result.workspace.lowest_factor,
        "velocity transmission, tool over carriages",
    )
    highest_factor: float = of(lambda result: result.workspace.highest_factor)
    factors_at_zero: Numbers = of(lambda result: result.workspace.at_zero.tolist())
    limit: float = of(lambda result: result.workspace.limit)
    within_limit: float = of(
        lambda result: result.workspace.inside,
        "share of the workspace, factors 1/limit … limit",
    )
    largest_cube: Cube | None = of(
        lambda result: maybe(Cube.of, result.workspace.cube),
        "null: none",
    )
    theta_deg: Matrix = of(
        lambda result: result.workspace.theta_deg.tolist(),
        "of legs x, y, z, lowest and highest; papers/000 (1)",
    )
    beta_deg: Matrix = of(lambda result: result.workspace.beta_deg.tolist())
    maps: tuple[FactorMap, ...] = of(lambda result: tuple(map(FactorMap.of, result.workspace.maps)))


@dataclass(frozen=True, eq=False)
class PostureResults:
    """One place of the tool of a machine."""

    machine: Machine
    posture: PostureOfTool


class PostureReport(Report):
    """``workspace --at --json``: one place of the tool."""

    of = Source[PostureResults]()
    schema_id: Literal["glidecal.posture/1"] = schema("glidecal.posture/1")
    machine: str = of(lambda result: result.machine.name)
    tool_mm: tuple[float, float, float] = of(lambda result: result.posture.tool_mm)
    stands: bool = of(lambda result: result.posture.stands, "joint limits and bars allow it")
    theta_deg: Numbers = of(
        lambda result: result.posture.theta_deg.tolist(), "of legs x, y, z; papers/000 (1)"
    )
    beta_deg: Numbers = of(lambda result: result.posture.beta_deg.tolist())
    factors: Numbers = of(
        lambda result: result.posture.factors.tolist(),
        "velocity transmission, tool over carriages",
    )
    working_modes: tuple[WorkingMode, ...] = of(
        lambda result: result.posture.modes, "the machine's own first"
    )
    other_assembly_mm: Numbers = of(
        lambda result: result.posture.assembly_mm.tolist(), "where the same bars meet as well"
    )
