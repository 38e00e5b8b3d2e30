"""The typed events of a session, one line of the record each, and the state they fold into: what
counts, what is done, what is next.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, date, datetime
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, AwareDatetime, Field, TypeAdapter, model_validator

from calib.errors import GlidecalError, RecordError
from protocols.data_table import Cell, DataTable, Tabled
from protocols.documents import (
    Celsius,
    Count,
    Document,
    FigureMm,
    LengthMm,
    Name,
    Origin,
    Seconds,
    Seed,
    Triple,
)
from protocols.machine import Instrument, Machine
from protocols.procedure import SLIDING, Leg, Procedure, Step, Touched, position_words

SchemaId = Literal[
    "glidecal.session/1",
    "glidecal.session/2",
    "glidecal.session/3",
    "glidecal.session/4",
    "glidecal.session/5",
    "glidecal.session/6",
    "glidecal.session/7",
    "glidecal.session/8",
    "glidecal.session/9",
    "glidecal.session/10",
    "glidecal.session/11",
]
"""Every schema of a record. A changed event needs a new one: docs/decisions/0003-record.md."""

SCHEMA: SchemaId = get_args(SchemaId)[-1]
SCHEMA_NUMBER = len(get_args(SchemaId))
"""Of what is written; it and all before it are read."""

FIRST_DIGEST = "0" * 64


def local_now() -> datetime:
    """The clock of the computer, with its offset from UTC: a day is that of the place."""
    return datetime.now(UTC).astimezone()


class Line(Document):
    """What every line carries: its number, the digest of the line before it, the wall clock.

    ``seal`` is the digest of this line with an empty seal: no later line vouches for the last one.
    Lines of older programs have none, but for the closing one.
    """

    line: int = 0
    previous: str = FIRST_DIGEST
    at: AwareDatetime = Field(default_factory=local_now)
    seal: str = ""


def _beside(name: str) -> str:
    if name in {"", ".", ".."} or any(mark in name for mark in "/\\\0"):
        raise ValueError("the name of a session in the same folder, without a path")
    return name


LARGEST_READING_MM = 1000.0
"""No indicator moves so far: a reading beyond is a fault of the device, or of a table."""

MeasuredMm = Annotated[LengthMm, Field(gt=0.0)]
FileName = Annotated[Name, AfterValidator(_beside)]


class Beginning(Line):
    """First line of a session of any kind of machine.

    ``measured_on`` is stated of an imported table, whose lines were written later.
    """

    event: Literal["opened"] = "opened"
    schema_id: str = Field(alias="schema")
    program: Name
    origin: Origin
    measured_on: date | None = None

    @property
    def measured_at(self) -> datetime:
        """When it was measured: of an imported table the stated day, else when it was imported."""
        day = self.measured_on
        return datetime(day.year, day.month, day.day, tzinfo=UTC) if day else self.at

    @property
    def is_dated(self) -> bool:
        """Whether it is known when it was measured."""
        return self.origin != "imported" or self.measured_on is not None

    def measured_words(self, form: str = "%Y-%m-%d") -> str:
        """When it was measured, in this form; of a table the day, or that nobody stated it."""
        recorded = format(self.at, form)
        if self.origin != "imported":
            return recorded
        return f"{self.measured_on or 'not stated'}, imported {recorded}"

    def measured_days(self, readings: Iterable[Line]) -> tuple[date, date]:
        """The day when it began, and that of its last reading; of a table the day of all."""
        first = self.measured_at.date()
        if self.origin == "imported":
            return first, first
        return first, max([first, *(reading.at.date() for reading in readings)])

    def day_words(self, readings: Iterable[Line]) -> str:
        """The days when it was measured; where nobody stated it, the day of the import."""
        if not self.is_dated:
            return self.measured_words()
        return " to ".join(f"{day}" for day in dict.fromkeys(self.measured_days(readings)))


class Opened(Beginning):
    """First line: the schema and everything known before measuring.

    ``seed`` is set for simulated machines only, so that an interrupted simulation can go on;
    ``computer`` tells the computers apart on which ports were named;
    ``verifies`` names the session whose offsets were entered before this one; ``aligned_to`` is the
    rail that stays where rails are aligned between rounds. ``measured_on`` is stated of an imported
    table, whose lines were written later.
    """

    schema_id: SchemaId = Field(alias="schema", default=SCHEMA)
    machine: Machine
    procedure: Procedure | None = None
    instruments: Annotated[tuple[Instrument, ...], Field(max_length=2)] = ()
    seed: Seed | None = None
    operator: Name = ""
    temperature_c: Celsius | None = None
    verifies: FileName | None = None
    aligned_to: Leg | None = None
    computer: Name | None = None
    remarks: tuple[Name, ...] = ()

    @model_validator(mode="after")
    def _measurable(self) -> Opened:
        try:
            self.steps()
        except GlidecalError as problem:
            raise ValueError(str(problem)) from problem
        return self

    def steps(self) -> tuple[Step, ...]:
        """The steps of the procedure on these instruments; none for an imported table."""
        if self.procedure is None or not self.instruments:
            return ()
        axes = tuple(instrument.axes for instrument in self.instruments)
        return self.procedure.steps(self.machine.geometry(), axes)


class Mounted(Line):
    """The stand was set up: from here on these mountings have a new zero."""

    event: Literal["mounted"] = "mounted"
    leg: Touched
    station: Annotated[float, Field(ge=0.0, le=1.0)]
    mounts: dict[Leg, Name]
    over_plane: bool | None = None

    @property
    def place(self) -> tuple[str, float, set[str]]:
        """Where the stand is: leg, station and axes; on a plane it slides."""
        return self.leg, SLIDING if self.over_plane else self.station, set(self.mounts)


class Moved(Document):
    """How a controller moved the machine to a posture: its coordinates and positions, mm.

    The last straight move began at ``from_mm``; ``read_back_mm`` is what the controller read then.
    """

    driver: Name
    coordinates: Literal["tool", "joint"]
    from_mm: Triple
    commanded_mm: Triple
    read_back_mm: Triple
    feed_mm_min: Annotated[float, Field(gt=0.0, le=1e6)]

    def cells(self) -> tuple[Cell, ...]:
        """Cells of the columns `MOVED` of a table."""
        places = (*self.from_mm, *self.commanded_mm, *self.read_back_mm)
        return (self.driver, self.coordinates, *places, self.feed_mm_min)


class Reading(Line):
    """One value of one indicator, with the text that the device or the table gave.

    ``time_s`` counts from the beginning of the session by a clock that nobody sets.
    A reading of the tool stands at ``position_mm`` from Zero, its displacement and station are 0;
    where the tool came to it along the axis, ``lift_mm`` is from how far. With ``over_plane`` the
    stand slid on a reference plane to the station, in this posture. ``moved`` tells of a machine
    that was moved by its controller; None where the operator did it.

    With ``contact`` no indicator read: sent to ``position_mm`` the tool was on a plate, and
    ``value_mm`` is its height over it, 0 where it touches; the text is that of the place.
    """

    event: Literal["reading"] = "reading"
    reading: Annotated[int, Field(ge=1)]
    step: Count | None = None
    leg: Touched
    axis: Leg
    displacement_mm: LengthMm
    position_mm: Triple | None = None
    lift_mm: Annotated[float, Field(ge=0.0, le=1000.0)] | None = None
    value_mm: LengthMm
    text: str
    cycle: Count = 1
    mount: Name
    station: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    time_s: Seconds | None = None
    temperature_c: Celsius | None = None
    averaged: Count = 1
    resolution_mm: FigureMm | None = None
    unit_assumed: bool = False
    over_plane: bool | None = None
    contact: bool | None = None
    moved: Moved | None = None
    extra: dict[Name, Name] = Field(default_factory=dict)

    @classmethod
    def of_step(cls, step: Step, axis: Leg, procedure: Procedure | None, **values: Any) -> Self:  # noqa: ANN401 (of other fields)
        """A reading along one axis of a step; ``values`` are those of the other fields."""
        plate = procedure.plate if procedure else None
        return cls(
            step=step.number,
            leg=step.leg,
            axis=axis,
            displacement_mm=step.displacement_mm,
            position_mm=step.position_mm,
            lift_mm=plate.lift_mm or None if plate else None,
            cycle=step.cycle,
            station=step.station,
            over_plane=step.over_plane or None,
            **values,
        )

    @property
    def posture_mm(self) -> tuple[float, Triple | None]:
        """What the controller was told."""
        return self.displacement_mm, self.position_mm

    @property
    def set_up(self) -> tuple[str, str, float]:
        """Where the stand is: leg, axis and station; on a plane it slides."""
        return self.leg, self.axis, SLIDING if self.over_plane else self.station

    @property
    def place_words(self) -> str:
        """``leg X at +60 mm``, or ``the tool at (0, 30, 0) mm``."""
        if self.position_mm is not None:
            return f"the tool at {position_words(self.position_mm)}"
        return f"leg {self.leg.upper()} at {self.displacement_mm:+g} mm"

    @model_validator(mode="after")
    def _across_the_leg(self) -> Reading:
        if self.axis == self.leg:
            raise ValueError(f"axis {self.axis} is along the leg")
        if (self.leg == "tool") != (self.position_mm is not None):
            raise ValueError("position_mm: a reading of the tool has one, one of a leg has none")
        if self.over_plane and self.leg == "tool":
            raise ValueError("over_plane: a leg is read over a plane, not the tool")
        if self.contact and self.leg != "tool":
            raise ValueError("contact: the tool meets a plate, not a leg")
        return self


class Distance(Line):
    """How far two marks are apart, as a person measured it: on a printed object, or a gauge block.

    The tool was sent to ``from_mm`` and ``to_mm`` from Zero; ``deviation_mm`` is the standard
    deviation of marking and measuring together. The text is what the file or table says.
    """

    event: Literal["distance"] = "distance"
    distance: Count
    from_mm: Triple
    to_mm: Triple
    value_mm: MeasuredMm
    deviation_mm: Annotated[FigureMm, Field(gt=0.0)]
    text: str

    @model_validator(mode="after")
    def _of_two_marks(self) -> Distance:
        if self.from_mm == self.to_mm:
            raise ValueError("to_mm: the same mark as from_mm; a distance has two")
        return self


class Superseded(Line):
    """Earlier readings that no longer count, and why. They stay in the record."""

    event: Literal["superseded"] = "superseded"
    readings: tuple[int, ...]
    reason: Name


class Skipped(Line):
    """Steps that are left out, and why."""

    event: Literal["skipped"] = "skipped"
    steps: tuple[int, ...]
    reason: Name


class Restored(Line):
    """Taken back: these readings count again, these steps are to be measured after all."""

    event: Literal["restored"] = "restored"
    readings: tuple[int, ...] = ()
    steps: tuple[int, ...] = ()
    reason: Name


class Faulted(Line):
    """An indicator gave a fault instead of a value."""

    event: Literal["faulted"] = "faulted"
    step: Count | None = None
    axis: Leg
    kind: Name
    text: str


class Noted(Line):
    """A remark of the operator."""

    event: Literal["noted"] = "noted"
    text: Name


class Continuation(Line):
    """A session of any kind of machine goes on after an interruption."""

    event: Literal["continued"] = "continued"
    schema_id: str | None = Field(alias="schema", default=None)
    program: Name
    torn_bytes: int = 0
    paused_s: float | None = None


class Continued(Continuation):
    """The session goes on after an interruption; bytes of a torn last line were set aside.

    The lines from here on keep to ``schema_id``, None: to that of the first line.
    ``paused_s`` is the time since the line before, known by the wall clock only: ``time_s`` of the
    readings goes on by so much, or by nothing where the clock was set back.
    """

    schema_id: SchemaId | None = Field(alias="schema", default=None)


class Changed(Line):
    """Parts of the machine were moved: what was read before is of another machine.

    One end of a rail: ``rail``, the axis ``towards`` that it was moved along, ``support_mm`` where
    it rests, what was asked for and, where an indicator watched, what it moved.
    """

    event: Literal["changed"] = "changed"
    rail: Leg | None = None
    towards: Leg | None = None
    support_mm: LengthMm | None = None
    asked_mm: LengthMm | None = None
    moved_mm: LengthMm | None = None
    reason: Name


class Closed(Line):
    """Last line: how many readings the session holds, superseded ones included."""

    event: Literal["closed"] = "closed"
    readings: int
    complete: bool


Event = Annotated[
    Opened
    | Mounted
    | Reading
    | Distance
    | Superseded
    | Skipped
    | Restored
    | Faulted
    | Noted
    | Continued
    | Changed
    | Closed,
    Field(discriminator="event"),
]
EVENT: TypeAdapter[Event] = TypeAdapter(Event)


OF_LEG = ("leg", "axis", "displacement_mm", "station", "plane")
OF_ANY = (
    *("device_text", "counts", "counts_reason", "cycle", "time_s", "mount", "temperature_c"),
    *("averaged", "resolution_mm", "unit_assumed", "seq"),
)
"""Columns of a table of readings behind place and value."""

MOVED_MM = tuple(f"{at}_{k}_mm" for at in ("from", "commanded", "read_back") for k in "123")
MOVED = ("moved_by", "moved_in", *MOVED_MM, "feed_mm_min")
"""Behind these where a controller moved the machine."""


def _place(reading: Reading) -> tuple[Cell, ...]:
    if reading.position_mm is not None:
        return (*reading.position_mm, reading.axis, reading.lift_mm)
    where = (reading.leg, reading.axis, reading.displacement_mm, reading.station)
    return (*where, int(reading.over_plane or False))


CHANGED = "the machine was changed"

DECIMALS = re.compile(r"\d*\.(\d+)$", re.ASCII)


@dataclass(frozen=True)
class Session(Tabled):
    """State of a session after its events.

    ``readings`` are those that count, in the order taken; ``superseded`` maps the numbers of the
    others to the reason, ``restored`` the numbers of those that count again, ``skipped`` the
    numbers of the steps that are left out; ``notes`` are the remarks made on the way,
    ``distances`` those between marks since the last change of the machine. A ``closed`` one is not
    continued. ``name`` and ``digest`` are those of its record, empty where it has none.
    ``known_steps`` stand in place of those of the procedure, which a table has not.
    """

    opened: Opened
    readings: tuple[Reading, ...]
    superseded: dict[int, str]
    restored: dict[int, str]
    skipped: dict[int, str]
    all_readings: tuple[Reading, ...]
    mountings: tuple[Mounted, ...]
    stand_untouched: bool
    notes: tuple[str, ...] = ()
    changes: tuple[Changed, ...] = ()
    distances: tuple[Distance, ...] = ()
    closed: bool = False
    name: str = ""
    digest: str = ""
    known_steps: tuple[Step, ...] | None = None

    def __repr__(self) -> str:
        return f"Session({self.name!r}, {len(self.readings)} readings)"

    @property
    def adjusted(self) -> str | None:
        """In which mechanical state the readings that count were taken; None: never changed."""
        if self.changes:
            return f"{self.changes[-1].at:%Y-%m-%d %H:%M:%S}"
        return self.opened.machine.adjusted

    @cached_property
    def _steps(self) -> tuple[Step, ...]:
        # the screen asks with every picture
        return self.opened.steps() if self.known_steps is None else self.known_steps

    def steps(self) -> tuple[Step, ...]:
        """The steps of the session's procedure; none for an imported table."""
        return self._steps

    def is_new_place(self, step: Step) -> bool:
        """Whether the stand must be set up for a step: another leg, station or axis."""
        last = self.mountings[-1] if self.mountings else None
        leg, station, axes = step.place
        return last is None or last.place != (leg, station, set(axes))

    def has_readings_at(self, step: Step) -> bool:
        """Whether any reading that counts was taken where the stand is for a step."""
        leg, station, _ = step.place
        return any((r.leg, r.set_up[2]) == (leg, station) for r in self.readings)

    def needs_new_zero(self, step: Step) -> bool:
        """Whether readings from here on belong to a new mounting: a new place, or after a break.

        Nobody knows what happened to stand and indicators while the program did not run.
        """
        return self.is_new_place(step) or not self.stand_untouched

    @property
    def last_is_alone(self) -> bool:
        """Whether the mounting read last has one posture, which without another gives nothing."""
        last = self.readings[-1].mount if self.readings else ""
        of_last = [reading for reading in self.readings if reading.mount == last]
        return len({reading.posture_mm for reading in of_last}) == 1

    def done(self) -> frozenset[int]:
        """Numbers of the steps for which every axis has a reading that counts."""
        axes: dict[int, set[str]] = {}
        for reading in self.readings:
            if reading.step is not None:
                axes.setdefault(reading.step, set()).add(reading.axis)
        step_axes = {step.number: set(step.axes) for step in self.steps()}
        return frozenset(
            n for n, reading_axes in axes.items() if reading_axes >= step_axes.get(n, set("?"))
        )

    def next_step(self) -> Step | None:
        """The first step that is neither done nor skipped."""
        settled = self.done() | self.skipped.keys()
        return next((step for step in self.steps() if step.number not in settled), None)

    @property
    def complete(self) -> bool:
        """Whether every step of the procedure has readings that count; none was skipped."""
        return self.done() >= {step.number for step in self.steps()}

    def time_goes_back(self) -> Reading | None:
        """The first reading with an earlier ``time_s`` than the one before: the clock was set."""
        timed = [(r.time_s, r) for r in self.all_readings if r.time_s is not None]
        return next((r for (a, _), (b, r) in pairwise(timed) if b < a), None)

    def table(self) -> DataTable:
        """Every reading, as `protocols.table` reads it: columns of docs/session.md.

        Those that do not count are among them: the machine was there. Raises RecordError for
        readings of legs and of the tool, or contacts and readings, in one session.
        """
        of_tool = {reading.leg == "tool" for reading in self.all_readings}
        if len(of_tool) > 1:
            raise RecordError("session", "readings of legs and of the tool", "one of both")
        if len({reading.contact or False for reading in self.all_readings}) > 1:
            raise RecordError("session", "contacts and readings of an indicator", "one of both")
        places = ("x_mm", "y_mm", "z_mm", "axis", "lift_mm") if True in of_tool else OF_LEG
        columns = (*places, "height_mm" if self.of_contacts else "value_mm", *OF_ANY)
        moved = MOVED if any(reading.moved for reading in self.all_readings) else ()
        extra = list(dict.fromkeys(name for reading in self.all_readings for name in reading.extra))
        # columns of an old table that nobody knew then, under names that are nobody's now
        extra_columns = (f"{name} (kept)" if name in (*columns, *MOVED) else name for name in extra)
        return DataTable.plain(
            (*columns, *moved, *extra_columns),
            (
                (
                    *_place(reading),
                    reading.value_mm,
                    reading.text,
                    *self._counting(reading.reading),
                    reading.cycle,
                    reading.time_s,
                    reading.mount,
                    reading.temperature_c,
                    reading.averaged,
                    reading.resolution_mm,
                    int(reading.unit_assumed),
                    reading.reading,
                    *(reading.moved.cells() if reading.moved else [None] * len(moved)),
                    *(reading.extra.get(name) for name in extra),
                )
                for reading in self.all_readings
            ),
        )

    @property
    def of_contacts(self) -> bool:
        """Whether every reading is a contact, with which no indicator has to do."""
        return bool(self.all_readings) and all(reading.contact for reading in self.all_readings)

    def _counting(self, number: int) -> tuple[str, str]:
        """Whether a reading counts, and why or why not."""
        if number in self.superseded:
            return "no", self.superseded[number]
        return ("again", self.restored[number]) if number in self.restored else ("yes", "")

    @cached_property
    def step_mm(self) -> float | None:
        """The step in which the readings are written down: the finest decimal of any text."""
        matches = map(DECIMALS.search, {reading.text for reading in self.readings})
        decimals = [len(match[1]) for match in matches if match]
        return 10.0 ** -max(decimals) if decimals else None


def fold(events: Iterable[Event]) -> Session:
    """The state after these events; the first one must be `Opened`."""
    sequence = tuple(events)
    opened = sequence[0]
    assert isinstance(opened, Opened)
    readings: list[Reading] = []
    superseded: dict[int, str] = {}
    restored: dict[int, str] = {}
    skipped: dict[int, str] = {}
    distances: list[Distance] = []
    stand_untouched = True
    for event in sequence:
        match event:
            case Reading():
                readings.append(event)
            case Distance():
                distances.append(event)
            case Superseded():
                superseded |= dict.fromkeys(event.readings, event.reason)
                restored = _without(restored, event.readings)
            case Skipped():
                skipped |= dict.fromkeys(event.steps, event.reason)
            case Restored():
                superseded = _without(superseded, event.readings)
                restored |= dict.fromkeys(event.readings, event.reason)
                skipped = _without(skipped, event.steps)
            case Mounted() | Continued():
                stand_untouched = isinstance(event, Mounted)
            case Changed():
                numbers = (r.reading for r in readings if r.reading not in superseded)
                superseded |= dict.fromkeys(numbers, f"{CHANGED}: {event.reason}")
                restored, skipped, distances, stand_untouched = {}, {}, [], False
    return Session(
        opened,
        tuple(reading for reading in readings if reading.reading not in superseded),
        superseded,
        restored,
        skipped,
        tuple(readings),
        tuple(event for event in sequence if isinstance(event, Mounted)),
        stand_untouched,
        tuple(event.text for event in sequence if isinstance(event, Noted)),
        tuple(event for event in sequence if isinstance(event, Changed)),
        tuple(distances),
        closed=isinstance(sequence[-1], Closed),
    )


def _without(reasons: dict[int, str], numbers: tuple[int, ...]) -> dict[int, str]:
    return {number: reason for number, reason in reasons.items() if number not in numbers}
