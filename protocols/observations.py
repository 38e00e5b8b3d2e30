"""The only place where records become arrays, and what a diagnosis corrected readings again."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from calib.arrays import (
    LEG_NAMES,
    TOUCHED_NAMES,
    FloatArray,
    IntArray,
    Observations,
    numbered,
    rows_of,
)
from calib.errors import NotIdentifiable, RecordError, UsageError
from calib.noise.display import display_step_mm
from calib.noise.reading import IndicatorFigures
from calib.tripod.geometry import PARAMETER_NAMES, Geometry
from calib.tripod.movements import carriage_movement
from calib.tripod.pipeline import simulate
from protocols.documents import ZERO, Triple, triple
from protocols.machine import Instrument, Machine
from protocols.motion import approach_sign, departure_mm, movement_signs
from protocols.procedure import Step, leg_number
from protocols.session import Reading, Session

if TYPE_CHECKING:
    from calib.diagnosis.results import CleanedReadings
    from calib.posterior.distances import Distances


def to_observations(sessions: Sequence[Session]) -> Observations:
    """Readings that count of one or more sessions of one machine, in the order taken.

    Mountings of different sessions are different mountings. Raises UsageError where the sessions
    are of different machines, RecordError for legs of a machine that has none to read and
    NotIdentifiable where there is no reading.
    """
    _check_same_machine(sessions)
    for session in sessions:
        _check_readings(session)
    readings = [reading for session in sessions for reading in session.readings]
    if not readings:
        raise NotIdentifiable("readings", "none", "a session with readings in two postures")
    machine = sessions[0].opened.machine
    contact = np.array([r.contact for r in readings], dtype=bool)  # None is False
    by_hand = np.array([r.mount == BY_HAND for r in readings])
    numbered_sessions = [*enumerate(sessions)]
    mounts = [f"{n}/{r.mount}" for n, session in numbered_sessions for r in session.readings]
    indicators = [
        f"{n}/{name}" for n, session in numbered_sessions for name in _indicators(session)
    ]
    observations = Observations(
        leg=np.array([NUMBERS[r.leg] for r in readings], dtype=np.intp),
        axis=np.array([NUMBERS[r.axis] for r in readings], dtype=np.intp),
        displacement_mm=np.array([r.displacement_mm for r in readings]),
        station=np.array([r.station for r in readings]),
        approach=np.concatenate([approaches(session) for session in sessions]),
        cycle=np.array([r.cycle for r in readings], dtype=np.intp),
        time_s=np.concatenate([_times_s(session) for session in sessions]),
        # None is NaN
        temperature_c=np.array([r.temperature_c for r in readings], dtype=np.float64),
        mount=numbers_of(mounts),
        indicator=numbers_of(indicators),
        position_mm=np.array([r.position_mm or ZERO for r in readings]),
        movement=np.concatenate([_movements(session) for session in sessions]),
        along_mm=np.array([along_mm(r, machine) for r in readings]),
        contact=contact,
        beside_mm=np.where((contact & ~by_hand)[:, None], machine.beside_mm, 0.0),
        value_mm=np.array([r.value_mm for r in readings]),
        averaged=np.array([r.averaged for r in readings], dtype=np.float64),
    )
    observations = _as_commanded(observations, readings, machine.geometry())
    return _repeated(observations)


NUMBERS = {name: leg_number(name) for name in TOUCHED_NAMES}


def numbers_of(names: Sequence[Hashable]) -> IntArray:
    """Numbers ``(n,)`` of names, in the order in which these come first."""
    number = {name: k for k, name in enumerate(dict.fromkeys(names))}
    return np.array([number[name] for name in names], dtype=np.intp)


def _as_commanded(
    commanded: Observations, readings: Sequence[Reading], geometry: Geometry
) -> Observations:
    """What would have been read exactly where the controller was sent.

    Read back, the machine stood beside it, by hundredths of a millimetre at most: so much as a
    nominal machine's reading changes over that is taken away. The true machine's changes by some
    hundredth more or less, which no indicator shows.
    """
    departure = np.array([departure_mm(r.moved, geometry) if r.moved else ZERO for r in readings])
    if not departure.any():
        return commanded
    displaced = replace(commanded, position_mm=commanded.position_mm + departure)
    nominal = np.zeros(len(PARAMETER_NAMES))
    change = simulate(geometry, nominal, displaced) - simulate(geometry, nominal, commanded)
    return replace(commanded, value_mm=commanded.value_mm - change)


BY_HAND = "tool-z, by hand"
"""Mounting of heights that were measured by hand: a probe trips at a height of its own."""

SAME_PLACE_MM = 0.05
"""Across the plate: so far apart two contacts may be to be repeats. On a machine that is off by
5 mm in 1 m the heights differ by 0.25 µm."""

CONTACT_FROM_MM = 1.0
"""A tool that meets a plate came to it along the axis, if nothing else is stated from so far."""


def _repeated(observations: Observations) -> Observations:
    """Contacts of one place as repeats: at the mean of their positions.

    A tool that was sent a little higher than the mean of its repeats is so much higher there: a
    machine that is off by 5 mm in 1 m changes that by half a percent.
    """
    value_mm, position_mm = observations.value_mm.copy(), observations.position_mm.copy()
    touching = np.flatnonzero(observations.contact)
    place_groups = numbered(
        observations.mount[touching], observations.axis[touching], value_mm[touching]
    )
    for rows in rows_of(place_groups):
        contacts = touching[rows]
        while len(contacts):
            axis = int(observations.axis[contacts[0]])
            away_mm = np.delete(position_mm[contacts] - position_mm[contacts[0]], axis, axis=1)
            near = np.abs(away_mm).max(axis=1) <= SAME_PLACE_MM
            place, contacts = contacts[near], contacts[~near]
            mean_mm = position_mm[place].mean(axis=0)
            value_mm[place] -= position_mm[place, axis] - mean_mm[axis]
            position_mm[place] = mean_mm
    return replace(observations, value_mm=value_mm, position_mm=position_mm)


def measured_distances(session: Session) -> Distances:
    """Distances between marks as arrays, mm."""
    from calib.posterior.distances import Distances  # the effects come with it

    distances = session.distances
    return Distances(
        np.array([distance.from_mm for distance in distances]).reshape(-1, 3),
        np.array([distance.to_mm for distance in distances]).reshape(-1, 3),
        np.array([distance.value_mm for distance in distances]),
        np.array([distance.deviation_mm for distance in distances]),
    )


def along_mm(reading: Reading | Step, machine: Machine) -> float:
    """Where a leg is touched over a plane, from the tool at Zero; NaN elsewhere."""
    if not reading.over_plane:
        return np.nan
    covered = machine.geometry().covered_mm[leg_number(reading.leg)]
    return float(reading.displacement_mm + reading.station * covered)


def _times_s(session: Session) -> list[float]:
    """NaN where no time is known, and for a whole session whose times go back somewhere."""
    if session.time_goes_back():
        return [np.nan] * len(session.readings)
    return [np.nan if r.time_s is None else r.time_s for r in session.readings]


def _indicators(session: Session) -> list[str]:
    """Which indicator took each reading that counts: by its place in the step.

    A table does not tell; there each mounting counts as an indicator of its own.
    """
    steps = {step.number: step for step in session.steps()}
    return [
        str(steps[r.step].indicators[steps[r.step].axes.index(r.axis)])
        if r.step in steps
        else r.mount
        for r in session.readings
    ]


def _by_mounting(readings: Iterable[Reading]) -> Iterable[list[Reading]]:
    groups: dict[str, list[Reading]] = {}
    for reading in readings:
        groups.setdefault(reading.mount, []).append(reading)
    return groups.values()


def approaches(session: Session) -> list[float]:
    """Sign of the last movement before each reading that counts, from the rows of its mounting.

    Superseded readings do not count, but the machine was there. A controller tells it itself.
    """
    signs: dict[int, float] = {}
    geometry = session.opened.machine.geometry()
    for members in _by_mounting(session.all_readings):
        displacement_mm = np.array([reading.displacement_mm for reading in members])
        # the first came from nowhere known
        sign = np.sign(np.diff(displacement_mm, prepend=displacement_mm[:1]))
        for row, reading in enumerate(members):
            if reading.moved is not None:
                sign[row] = approach_sign(reading.moved, reading.leg, geometry)
        last = np.maximum.accumulate(np.where(sign != 0.0, np.arange(len(sign)), 0))
        signs |= zip((reading.reading for reading in members), sign[last].tolist(), strict=True)
    return [signs.get(reading.reading, 0.0) for reading in session.readings]


def _movements(session: Session) -> FloatArray:
    """Signs ``(n, 3)`` of each carriage's last movement before each reading of the tool.

    From the rows of its mounting, or along the axis where the tool lifts off in between, as it
    does before each contact.
    """
    row_of = {reading.reading: row for row, reading in enumerate(session.readings)}
    signs = np.zeros((len(row_of), 3))
    geometry = session.opened.machine.geometry()
    for members in _by_mounting(r for r in session.all_readings if r.position_mm is not None):
        places_mm = np.array([reading.position_mm for reading in members])
        origins_mm = np.vstack([places_mm[:1], places_mm[:-1]])
        lifted = np.array([[r.lift_mm or (CONTACT_FROM_MM if r.contact else 0.0)] for r in members])
        above = places_mm + lifted * np.eye(3)[[leg_number(r.axis) for r in members]]
        moved = carriage_movement(geometry, np.where(lifted > 0.0, above, origins_mm), places_mm)
        last = np.zeros(3)
        for reading, movement in zip(members, moved, strict=True):
            if reading.moved is not None:
                movement = movement_signs(reading.moved, geometry)
            last = np.where(movement != 0.0, movement, last)
            if reading.reading in row_of:
                signs[row_of[reading.reading]] = last
    return signs


def _check_readings(session: Session) -> None:
    """Raises RecordError for readings of legs that no indicator can read."""
    if session.opened.machine.geometry().reads_legs:
        return
    on_leg = next((r for r in session.readings if r.leg != "tool"), None)
    if on_leg is not None:
        raise RecordError(
            f"reading {on_leg.reading} of machine '{session.opened.machine.name}'",
            f"leg {on_leg.leg}, whose bar is nowhere along its drive",
            "readings of the tool",
        )


def changed_between(subject: str, verb: str) -> UsageError:
    """Sessions between which parts of the machine were moved are of two machines."""
    return UsageError(
        subject,
        "the machine mechanically changed between them",
        "sessions of one mechanical state",
        f"{verb.capitalize()} them one at a time: offsets from before are not valid after it.",
    )


BESIDE_READINGS = {
    "place",
    "procedure",
    "mdi",
    "fastest_feed_mm_min",
    "motion",
    "indicator",
    "tool_tolerance_mm",
}
"""Keys of a machine file on which no reading depends; those of the last session are used."""


def _check_same_machine(sessions: Sequence[Session]) -> None:
    machines = [session.opened.machine for session in sessions]
    if len({session.adjusted for session in sessions}) > 1:
        raise changed_between(f"sessions of '{machines[0].name}'", "solve")
    first = machines[0]
    for session, machine in zip(sessions[1:], machines[1:], strict=True):
        keys = [
            key
            for key in Machine.model_fields
            if key not in BESIDE_READINGS and getattr(machine, key) != getattr(first, key)
        ]
        if keys == ["entered_offsets_mm"]:
            offsets = (
                f"({', '.join(f'{offset_mm:.4g}' for offset_mm in entered.entered_offsets_mm)})"
                for entered in (first, machine)
            )
            raise UsageError(
                f"sessions {sessions[0].name} and {session.name}",
                f"offsets entered between them, entered_offsets_mm {' and '.join(offsets)}",
                "sessions with the same offsets entered",
                "glidecal verify BEFORE AFTER compares them; solve takes them one at a time.",
            )
        if keys:
            raise UsageError(
                "sessions of different machines",
                f"'{first.name}' and '{machine.name}' with other {', '.join(keys)}",
                "sessions of one machine with the same offsets entered",
                "Solve them one at a time.",
            )


def indicator_figures(sessions: Sequence[Session]) -> IndicatorFigures:
    """The worst that is stated or seen of the indicators of all sessions.

    ``resolution_mm`` is the coarsest stated of an indicator or with a reading, ``step_mm`` the
    coarsest step in which the readings of a session are written down, ``values_step_mm`` the
    coarsest one on which its values lie.
    """
    worst = worst_stated(
        instrument for session in sessions for instrument in session.opened.instruments
    )
    resolutions_mm = {reading.resolution_mm for session in sessions for reading in session.readings}
    return replace(
        worst,
        resolution_mm=_worst([worst.resolution_mm, *resolutions_mm]),
        step_mm=_worst(session.step_mm for session in sessions),
        values_step_mm=_worst(_values_step_mm(session) for session in sessions),
    )


def _values_step_mm(session: Session) -> float | None:
    """The step of the display that the values of a session show; a mean of several is none.

    What was written down of a contact is its place.
    """
    written_mm = [
        r.position_mm[leg_number(r.axis)] if r.contact and r.position_mm else r.value_mm
        for r in session.readings
        if r.averaged == 1
    ]
    return display_step_mm(np.array(written_mm), session.step_mm)


def worst_stated(instruments: Iterable[Instrument]) -> IndicatorFigures:
    """The coarsest resolution and the worst repeatability that these indicators state."""
    figures = list(instruments)
    return IndicatorFigures(
        resolution_mm=_worst(instrument.resolution_mm for instrument in figures),
        repeatability_mm=_worst(instrument.repeatability_mm for instrument in figures),
    )


def _worst(figures: Iterable[float | None]) -> float | None:
    return max((figure for figure in figures if figure is not None), default=None)


SAME_MM = 1e-9
AS_READ = "as_read"
"""Beside a corrected reading: what the record that it is from says in its place."""


def corrected_readings(session: Session, cleaned: CleanedReadings) -> Iterator[Reading]:
    """The readings that differ from the session's, each with what that says of it.

    A stand that moved gives a new mounting from there on.
    """
    observations, cleaned_rows = to_observations([session]).take(cleaned.rows), cleaned.observations
    readings = [session.readings[row] for row in cleaned.rows.tolist()]
    recorded_mm = np.array([reading.value_mm for reading in readings])
    values = recorded_mm + (_values_mm(observations, cleaned) - observations.value_mm)
    mounts = _mount_names(readings, cleaned_rows)
    for k, reading in enumerate(readings):
        tool = TOUCHED_NAMES[cleaned_rows.leg[k]] == "tool"
        position_mm: Triple | None = None
        if tool:  # that of a contact is in the arrays with those of its repeats
            place_mm = cleaned_rows.position_mm[k]
            is_same = np.array_equal(place_mm, observations.position_mm[k])
            position_mm = reading.position_mm if is_same else triple(place_mm.tolist())
        mount = mounts[int(cleaned_rows.mount[k])]
        update: dict[str, Any] = {
            "value_mm": float(values[k]),
            "leg": TOUCHED_NAMES[cleaned_rows.leg[k]],
            "axis": LEG_NAMES[cleaned_rows.axis[k]],
            "displacement_mm": float(cleaned_rows.displacement_mm[k]),
            "position_mm": position_mm,
            "station": float(cleaned_rows.station[k]),
            "mount": f"{mount}, moved {cleaned.slips[k]}" if cleaned.slips[k] else mount,
        }
        original = {
            name: value for name in update if (value := getattr(reading, name)) != update[name]
        }
        if original:
            if original.keys() & {"leg", "displacement_mm", "position_mm"}:
                update |= {"step": None, "lift_mm": None}
            description = ", ".join(f"{name} {value}" for name, value in original.items())
            update["extra"] = {**reading.extra, AS_READ: description}
            yield reading.model_copy(update=update)


def _values_mm(observations: Observations, cleaned: CleanedReadings) -> FloatArray:
    """Corrected values ``(n,)``; as read where only the zero moved, for that is a new mounting."""
    values = cleaned.observations.value_mm.copy()
    change = values - observations.value_mm
    for mount in np.unique(observations.mount[cleaned.slips > 0]):
        for slip in range(1, int(cleaned.slips.max()) + 1):
            rows = (observations.mount == mount) & (cleaned.slips == slip)
            if rows.any() and np.ptp(change[rows]) < SAME_MM:
                values[rows] = observations.value_mm[rows]
    return np.where(np.abs(values - observations.value_mm) < SAME_MM, observations.value_mm, values)


def _mount_names(readings: Sequence[Reading], cleaned: Observations) -> list[str]:
    """The name that most readings of each mounting have: one of another may have come to it."""
    names = []
    for mount in range(cleaned.mount_count):
        rows = np.flatnonzero(cleaned.mount == mount).tolist()
        names.append(Counter(readings[row].mount for row in rows).most_common(1)[0][0])
    return names
