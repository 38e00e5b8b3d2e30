"""Records of measured sessions made in memory and on the disk, for tests of what reads them."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

from protocols.journal import Journal
from protocols.machine import Instrument, Machine
from protocols.procedure import Leg, load_procedure
from protocols.record import digest_of
from protocols.session import (
    FIRST_DIGEST,
    Continued,
    Event,
    Faulted,
    Mounted,
    Noted,
    Opened,
    Reading,
    Skipped,
    Superseded,
)

BEGIN = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
NOTE = "the stand slipped [red]here[/]"
REASON = "repeated by the [operator]"


def at(seconds: float) -> datetime:
    return BEGIN + timedelta(seconds=seconds)


def opened() -> Opened:
    machine = Machine(name="first")
    indicator = Instrument(profile="mitutoyo-01a", port="a", resolution_mm=0.001)
    return Opened(
        at=BEGIN,
        program="a test",
        origin="measured",
        machine=machine,
        procedure=load_procedure("zero-max-min", machine.geometry()),
        instruments=(indicator, indicator.model_copy(update={"port": "b"})),
        operator="Ida",
    )


def pair(number: int, step: int, level_mm: float, second: float, *, mount: str = "") -> list[Event]:
    """Both readings of a step on leg X; their values tell step and axis."""
    axes: tuple[Leg, Leg] = ("y", "z")
    return [
        Reading(
            at=at(second),
            reading=number + offset,
            step=step,
            leg="x",
            axis=axis,
            displacement_mm=level_mm,
            value_mm=value_mm,
            text=f"{value_mm:.3f}",
            cycle=1,
            mount=f"x{axis}{mount}",
            resolution_mm=0.001,
        )
        for offset, (axis, value_mm) in enumerate(zip(axes, (0.1 * step, -0.1 * step), strict=True))
    ]


def story() -> list[Event]:
    """Two steps, the second repeated after a fault; one skipped; a break of an hour; one more."""
    return [
        opened(),
        Mounted(at=at(20), leg="x", station=0.5, mounts={"y": "xy", "z": "xz"}),
        *pair(1, 1, 0.0, 20),
        *pair(3, 2, 60.0, 40),
        Noted(at=at(45), text=NOTE),
        Superseded(at=at(50), readings=(3, 4), reason=REASON),
        Faulted(at=at(55), step=2, axis="z", kind="no answer", text="E[1]"),
        *pair(5, 2, 60.0, 60),
        Skipped(at=at(70), steps=(3,), reason="out of reach"),
        Continued(at=at(3670), program="a test", torn_bytes=0),
        Mounted(at=at(3680), leg="x", station=0.5, mounts={"y": "xy#2", "z": "xz#2"}),
        *pair(7, 4, 0.0, 3680, mount="#2"),
    ]


def unsealed(path: Path) -> bytes:
    """A closed record as older programs wrote it: only its last line has a seal."""
    lines: list[bytes] = []
    previous = FIRST_DIGEST
    for line in path.read_bytes().splitlines():
        plain = json.loads(line) | {"previous": previous}
        plain.pop("seal", None)
        if plain["event"] == "closed":
            plain["seal"] = digest_of(compact(plain | {"seal": ""}))
        lines.append(compact(plain))
        previous = digest_of(lines[-1])
    return b"\n".join([*lines, b""])


def compact(plain: dict[str, object]) -> bytes:
    return json.dumps(plain, separators=(",", ":"), ensure_ascii=False).encode()


def write(path: Path, events: list[Event], *, close: bool) -> Path:
    """The events as a record on the disk."""
    first = events[0]
    assert isinstance(first, Opened)
    journal = Journal.create(path, first)
    journal.append(*events[1:])
    if close:
        journal.finish(complete=False)
    else:
        journal.close()
    return path
