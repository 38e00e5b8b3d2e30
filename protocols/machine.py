"""The machine file: what is known of one Orthoglide before measuring."""

from __future__ import annotations

import math
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from calib.errors import CalibrationError
from calib.orthoglide.geometry import Geometry
from protocols.documents import Document, FigureMm, LengthMm, Name, Tolerance, read_toml

Length = Annotated[float, Field(ge=0.001, le=100_000.0)]
Triple = tuple[LengthMm, LengthMm, LengthMm]

LEAST_GRAVITY = 1e-6
"""A shorter vector tells no direction."""


class Instrument(Document):
    """One indicator: profile and port, what it measures, and the maker's figures in mm.

    ``axes`` are the directions it may measure along, preferred ones first. ``channel`` belongs to
    interfaces with several inputs, ``pattern`` and ``request`` to the profile ``ascii-line``.
    """

    profile: Name
    port: Name = ""
    axes: Annotated[str, Field(pattern="^[xyz]{1,3}$")] = "xyz"
    unit: Literal["mm", "inch", "µm"] = "mm"
    channel: Annotated[int, Field(ge=1, le=99)] = 1
    resolution_mm: FigureMm | None = None
    repeatability_mm: FigureMm | None = None
    pattern: str | None = None
    request: str | None = None


class Machine(Document):
    """One machine: geometry in mm, and what its controller holds.

    ``home_offset_mm`` are the controller's present HOME_OFFSET values, needed to write new ones;
    ``entered_offsets_mm`` are joint offsets already entered when the session is measured;
    ``offset_tolerance_mm`` and ``length_tolerance_mm`` are standard deviations of how far joint
    offsets and leg lengths of such machines are off, before anything is measured;
    ``gravity`` is the direction in which weight pulls, of any length;
    ``load`` is the weight that the tool has now, in units of its usual one: another in a session
    with a mass hung on it; ``screw_lead_mm`` is the travel of a carriage for one turn of its
    screw, if it is known; ``mdi`` tells whether its controller is given tool or joint coordinates
    by hand; ``indicator`` are the indicators that are used with it.
    """

    schema_id: Literal["glidecal.machine/1"] = Field(alias="schema", default="glidecal.machine/1")
    name: Name = "orthoglide"
    leg_length_mm: Length = 310.25
    travel_max_mm: LengthMm = 60.0
    travel_min_mm: LengthMm = -100.0
    parallelogram_width_mm: Length = 80.0
    tool_radius_mm: Length = 31.0
    home_offset_mm: Triple | None = None
    entered_offsets_mm: Triple = (0.0, 0.0, 0.0)
    offset_tolerance_mm: Tolerance = 2.0
    length_tolerance_mm: Tolerance = 0.1
    gravity: Triple = (0.0, 0.0, -1.0)
    load: Annotated[float, Field(ge=0.001, le=1000.0)] = 1.0
    screw_lead_mm: Annotated[float, Field(ge=0.001, le=1000.0)] | None = None
    mdi: Literal["tool", "joint"] = "tool"
    indicator: tuple[Instrument, ...] = ()

    @field_validator("gravity")
    @classmethod
    def _pulls_somewhere(cls, gravity: Triple) -> Triple:
        if math.hypot(*gravity) < LEAST_GRAVITY:
            raise ValueError("a direction, such as [0.0, 0.0, -1.0]")
        return gravity

    @model_validator(mode="after")
    def _possible(self) -> Machine:
        try:
            self.geometry()
        except CalibrationError as problem:
            raise ValueError(str(problem)) from problem
        return self

    def tolerances_mm(self) -> tuple[float, ...]:
        """Tolerance of each base parameter, in their order."""
        return (self.offset_tolerance_mm,) * 3 + (self.length_tolerance_mm,) * 3

    def geometry(self) -> Geometry:
        """The nominal geometry for the mathematics."""
        return Geometry(
            leg_length_mm=self.leg_length_mm,
            travel_max_mm=self.travel_max_mm,
            travel_min_mm=self.travel_min_mm,
            parallelogram_width_mm=self.parallelogram_width_mm,
            tool_radius_mm=self.tool_radius_mm,
            gravity=_direction(self.gravity),
            screw_lead_mm=self.screw_lead_mm,
            load=self.load,
        )


def _direction(vector: Triple) -> Triple:
    """Unit vector."""
    x, y, z = (part / math.hypot(*vector) for part in vector)
    return x, y, z


def load_machine(path: Path | None) -> Machine:
    """The machine of a TOML file; without one the prototype of the papers. Raises RecordError."""
    if path is not None:
        return read_toml(path, Machine, "machine file")
    with resources.as_file(resources.files("protocols") / "machines" / "orthoglide.toml") as found:
        return read_toml(found, Machine, "machine file")
