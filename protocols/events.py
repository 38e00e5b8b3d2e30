"""The typed events of a session: one line of the record each."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import AwareDatetime, Field, TypeAdapter, model_validator

from protocols.documents import Document
from protocols.machine import Instrument, Machine
from protocols.procedure import Leg, Procedure

SCHEMA = "glidecal.session/1"
FIRST_DIGEST = "0" * 64


class Line(Document):
    """What every line carries: its number, the digest of the line before it, the wall clock.

    ``seal`` is the digest of this line with an empty seal: no later line vouches for the last one.
    Lines of older programs have none, but for the closing one.
    """

    line: int = 0
    previous: str = FIRST_DIGEST
    at: AwareDatetime = Field(default_factory=lambda: datetime.now(UTC))
    seal: str = ""


class Opened(Line):
    """First line: the schema and everything known before measuring.

    ``seed`` is set for simulated machines only, so that an interrupted simulation can go on;
    ``computer`` tells the computers apart on which ports were named;
    ``verifies`` names the session whose offsets were entered before this one.
    """

    event: Literal["opened"] = "opened"
    schema_id: Literal["glidecal.session/1"] = Field(alias="schema", default="glidecal.session/1")
    program: str
    origin: Literal["measured", "simulated", "imported"]
    machine: Machine
    procedure: Procedure | None = None
    instruments: tuple[Instrument, ...] = ()
    seed: int | None = None
    operator: str = ""
    temperature_c: float | None = None
    verifies: str | None = None
    computer: str | None = None
    remarks: tuple[str, ...] = ()


class Mounted(Line):
    """The stand was set up: from here on these mountings have a new zero."""

    event: Literal["mounted"] = "mounted"
    leg: Leg
    station: float
    mounts: dict[Leg, str]


class Reading(Line):
    """One value of one indicator, with the text that the device or the table gave.

    ``time_s`` counts from the beginning of the session by a clock that nobody sets.
    """

    event: Literal["reading"] = "reading"
    reading: Annotated[int, Field(ge=1)]
    step: int | None = None
    leg: Leg
    axis: Leg
    displacement_mm: float
    value_mm: float
    text: str
    cycle: int = 1
    mount: str
    station: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    time_s: float | None = None
    temperature_c: float | None = None
    averaged: Annotated[int, Field(ge=1)] = 1
    resolution_mm: float | None = None
    unit_assumed: bool = False
    extra: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _across_the_leg(self) -> Reading:
        if self.axis == self.leg:
            raise ValueError(f"axis {self.axis} lies along the leg")
        return self


class Superseded(Line):
    """Earlier readings that no longer count, and why. They stay in the record."""

    event: Literal["superseded"] = "superseded"
    readings: tuple[int, ...]
    reason: str


class Skipped(Line):
    """Steps that are left out, and why."""

    event: Literal["skipped"] = "skipped"
    steps: tuple[int, ...]
    reason: str


class Restored(Line):
    """Taken back: these readings count again, these steps are to be measured after all."""

    event: Literal["restored"] = "restored"
    readings: tuple[int, ...] = ()
    steps: tuple[int, ...] = ()
    reason: str


class Faulted(Line):
    """An indicator gave a fault instead of a value."""

    event: Literal["faulted"] = "faulted"
    step: int | None = None
    axis: Leg
    kind: str
    text: str


class Noted(Line):
    """A remark of the operator."""

    event: Literal["noted"] = "noted"
    text: str


class Continued(Line):
    """The session goes on after an interruption; bytes of a torn last line were set aside.

    ``paused_s`` is the time since the line before, known by the wall clock only: ``time_s`` of the
    readings goes on by so much, or by nothing where the clock was set back.
    """

    event: Literal["continued"] = "continued"
    program: str
    torn_bytes: int = 0
    paused_s: float | None = None


class Closed(Line):
    """Last line: how many readings the session holds, superseded ones included."""

    event: Literal["closed"] = "closed"
    readings: int
    complete: bool


Event = Annotated[
    Opened
    | Mounted
    | Reading
    | Superseded
    | Skipped
    | Restored
    | Faulted
    | Noted
    | Continued
    | Closed,
    Field(discriminator="event"),
]
EVENT: TypeAdapter[Event] = TypeAdapter(Event)
