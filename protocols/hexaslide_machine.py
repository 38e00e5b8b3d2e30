"""The machine file of a Hexa Slide: six chains, the box of its postures, a constraint link."""

from __future__ import annotations

import json
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from calib.errors import CalibrationError
from calib.hexaslide.geometry import (
    CHAINS,
    LEVEL,
    NOT_UNIT,
    Box,
    ConstraintLink,
    Geometry,
    HexaSlide,
    inverse,
)
from protocols.documents import Document, Name, read_toml

Coordinate = Annotated[float, Field(ge=-1000.0, le=1000.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Length = Annotated[float, Field(ge=1e-6, le=1000.0)]
Range = tuple[Coordinate, Coordinate]
Angle = Annotated[float, Field(ge=-360.0, le=360.0)]


def ordered(bounds: Range) -> Range:
    """Raises ValueError for bounds in the wrong order."""
    if not bounds[0] < bounds[1]:
        raise ValueError("the lower bound first, then a larger one")
    return bounds


class Chain(Document):
    """One chain, lengths in metres; ``rail`` is a unit vector, ``joint_m`` on the platform.

    ``travel_m`` is from where to where the slider may go; ``zeros_deg`` what encoders in the joint
    on the carriage read too much: of the turn about the rail, and of the angle to it.
    """

    start_m: Point
    rail: Point
    joint_m: Point
    link_m: Length
    travel_m: Range | None = None
    zeros_deg: tuple[Angle, Angle] = (0.0, 0.0)

    @field_validator("rail")
    @classmethod
    def _unit(cls, rail: Point) -> Point:
        square = sum(part * part for part in rail)
        if abs(square - 1.0) > NOT_UNIT:
            raise ValueError(f"a unit vector; this one has the length {square**0.5:.10g}")
        if abs(rail[2]) < LEVEL:
            raise ValueError(f"a rail that is not level, |z| ≥ {LEVEL:g}")
        return rail

    @field_validator("travel_m")
    @classmethod
    def _forward(cls, travel: Range | None) -> Range | None:
        return None if travel is None else ordered(travel)


class PostureBox(Document):
    """Bounds of the postures, lower before upper."""

    x_m: Range
    y_m: Range
    z_m: Range
    theta_deg: Range
    psi_deg: Range
    phi_deg: Range

    @field_validator("*")
    @classmethod
    def _ordered(cls, bounds: Range) -> Range:
        return ordered(bounds)

    def bounds(self) -> Box:
        """The box in metres and radians."""
        places = np.array([self.x_m, self.y_m, self.z_m])
        angles = np.radians([self.theta_deg, self.psi_deg, self.phi_deg])
        lower, upper = np.vstack([places, angles]).T
        return Box(lower, upper)


class LinkEnds(Document):
    """Ends of the constraint link in the frames of platform and base, and its length, metres."""

    platform_end_m: Point
    base_end_m: Point
    length_m: Length


class HexaSlideMachine(Document):
    """One Hexa Slide; checked to reach all of its box."""

    schema_id: Literal["glidecal.hexaslide/1"] = Field(
        alias="schema", default="glidecal.hexaslide/1"
    )
    name: Name
    chain: tuple[Chain, ...]
    box: PostureBox
    constraint_link: LinkEnds | None = None

    @field_validator("chain")
    @classmethod
    def _framed(cls, chain: tuple[Chain, ...]) -> tuple[Chain, ...]:
        if len(chain) != CHAINS:
            raise ValueError(f"six chains, each with its own [[chain]]; here are {len(chain)}")
        try:
            _geometry(chain)
        except CalibrationError as problem:
            raise ValueError(f"{problem.thing}: {problem.allowed}") from problem
        return chain

    @field_validator("box")
    @classmethod
    def _reached(cls, box: PostureBox, info: ValidationInfo) -> PostureBox:
        if "chain" in info.data:
            try:
                inverse(_geometry(info.data["chain"]), box.bounds().grid())
            except CalibrationError as problem:
                raise ValueError(f"{problem.thing}: {problem.found}") from problem
        return box

    def whole(self) -> HexaSlide:
        """The machine for the mathematics."""
        ends, link = self.constraint_link, None
        if ends is not None:
            platform_end, base_end = np.array(ends.platform_end_m), np.array(ends.base_end_m)
            link = ConstraintLink(platform_end, base_end, ends.length_m)
        travel = [one.travel_m or (-np.inf, np.inf) for one in self.chain]
        zeros = np.radians([one.zeros_deg for one in self.chain]).ravel()
        return HexaSlide(_geometry(self.chain), self.box.bounds(), link, zeros, np.array(travel).T)


def machine_text(machine: HexaSlideMachine, said: Iterable[str]) -> str:
    """The machine file, below what is ``said`` of it."""
    lines = [*(f"# {line}".rstrip() for line in said)]
    tables: list[tuple[str, Document]] = [("[[chain]]", one) for one in machine.chain]
    tables.append(("[box]", machine.box))
    if machine.constraint_link is not None:
        tables.append(("[constraint_link]", machine.constraint_link))
    lines += [f'schema = "{machine.schema_id}"', f"name = {json.dumps(machine.name)}"]
    for heading, table in tables:
        values = table.model_dump(mode="json", exclude_none=True)
        lines += ["", heading, *(f"{key} = {json.dumps(value)}" for key, value in values.items())]
    return "\n".join(lines) + "\n"


def _geometry(chain: tuple[Chain, ...]) -> Geometry:
    """Raises CalibrationError."""
    return Geometry(
        np.array([one.start_m for one in chain]),
        np.array([one.rail for one in chain]),
        np.array([one.joint_m for one in chain]),
        np.array([one.link_m for one in chain]),
    )


def load_hexaslide(path: Path | None = None) -> HexaSlideMachine:
    """The machine of a TOML file; without one the example H60. Raises RecordError."""
    if path is not None:
        return read_toml(path, HexaSlideMachine, "machine file")
    folder = resources.files("protocols") / "machines"
    with resources.as_file(folder / "hexaslide-h60.toml") as found:
        return read_toml(found, HexaSlideMachine, "machine file")
