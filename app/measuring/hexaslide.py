"""A session of postures of a Hexa Slide under way: whatever face drives it, typed or simulated.

A reading is on the disk before anything is told of it. What departs from expectation is a question
then: the operator takes it again or keeps it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from app.version import program
from calib.errors import CalibrationError, RecordError
from calib.hexaslide.expectation import (
    Departure,
    Expectation,
    OtherFrame,
    explanations,
    other_frame,
)
from calib.hexaslide.procedures import ANGLES
from protocols.hexaslide_session import (
    POSTURE_FORM,
    PostureCommands,
    PostureReading,
    PostureSession,
    PosturesOpened,
    SimulatedPostures,
    commands,
    fold_postures,
    typed_values,
)
from protocols.hexaslide_table import readings_of_table
from protocols.journal import Journal, write_whole
from protocols.session import Noted, Skipped, Superseded

GROSS = 1e-12
"""A table has no row that is less plausible: of 10,000 good ones none is."""

INDICATED = ("length",)
"""What an indicator in the link measures; it reads where nothing else is measured."""

KEPT = "kept although it was questioned"


def commanded(opened: PosturesOpened) -> PostureCommands:
    """Where the sliders are sent. Raises RecordError for a posture that cannot be."""
    if not opened.procedure.postures:
        raise RecordError(
            f"procedure {opened.procedure.name}",
            "no postures",
            "some in the file, or --posture-file",
            "glidecal postures finds them.",
        )
    return commands(opened.machine, opened.procedure)


@dataclass(frozen=True)
class PostureDoubt:
    """A reading that departs from expectation, None: the machine has no such posture; and mistakes
    that would explain it.
    """

    reading: PostureReading
    departure: Departure | None
    explanations: tuple[str, ...]


class PostureTaking:
    """One session, new or gone on with; close it where it is not finished."""

    def __init__(self, journal: Journal, commands: PostureCommands) -> None:
        self._journal, self.commands = journal, commands
        self._expectation = _at_first(self.session.opened)
        self.doubt = self._examined()

    @staticmethod
    def begin(path: Path, opened: PosturesOpened) -> PostureTaking:
        """A new record. Raises RecordError for its place, or a posture that cannot be."""
        targets = commanded(opened)
        first_line = opened.model_copy(update={"procedure": targets.procedure})
        return PostureTaking(Journal.create(path, first_line, POSTURE_FORM), targets)

    @staticmethod
    def resume(path: Path) -> PostureTaking:
        """An interrupted record. Raises RecordError where it is closed, altered or in use."""
        journal = Journal.resume(path, program(), POSTURE_FORM)
        try:
            opened = fold_postures(journal.events).opened
            # the postures of the record are held by a link already, and are not held once more
            sliders_mm = commands(opened.machine, opened.procedure).sliders_mm
            return PostureTaking(journal, PostureCommands(opened.procedure, sliders_mm))
        except BaseException:
            journal.close()
            raise

    @property
    def path(self) -> Path:
        """Path of the record."""
        return self._journal.path

    @property
    def session(self) -> PostureSession:
        """What was measured up to now."""
        return replace(fold_postures(self._journal.events), name=self._journal.path.name)

    def take(self, typed: str, text: str = "") -> PostureReading:
        """What was read in the next posture: on the disk, then examined; see `doubt`.

        ``text`` is what a device gave instead of what was typed. Raises UsageError for what is not
        so many numbers, RecordError where the disk refuses.
        """
        number = self.session.next_posture
        assert number is not None, "a posture is left"
        sliders, values = typed_values(typed, self.commands.procedure.whole())
        reading = PostureReading(
            reading=len(self.session.all_readings) + 1,
            posture=number,
            sliders_mm=sliders or self.commands.of(number),
            values=values,
            text=text or typed.strip(),
        )
        self._journal.append(reading)
        self.doubt = self._departing(reading)
        return reading

    def keep(self) -> None:
        """The doubtful reading counts, by the operator's word."""
        assert self.doubt is not None
        self._journal.append(Noted(text=f"reading {self.doubt.reading.reading}: {KEPT}"))
        if self.doubt.departure is not None:
            self._learn([self.doubt.reading])
        self.doubt = None

    def take_again(self, reason: str = "taken again") -> None:
        """The last reading no longer counts, its posture is the next one."""
        last = self.session.readings[-1]
        self._journal.append(Superseded(readings=(last.reading,), reason=reason))
        if self.doubt is None:  # it was believed, and tells nothing any more
            self._expectation = _at_first(self.session.opened)
            self._learn_from(self.session.readings)
        self.doubt = None

    def skip(self, reason: str) -> None:
        """Leave out the next posture."""
        number = self.session.next_posture
        assert number is not None, "a posture is left"
        self._journal.append(Skipped(steps=(number,), reason=reason))

    def finish(self) -> None:
        """Close the record: every posture is measured or left out."""
        self._journal.finish(complete=not self.session.skipped)

    def close(self) -> None:
        """Let go of the record, which can be gone on with."""
        self._journal.close()

    def _examined(self) -> PostureDoubt | None:
        """All readings up to now; the last one is asked about again where nobody answered."""
        session = self.session
        kept_numbers = {note.partition(":")[0] for note in session.notes if note.endswith(KEPT)}
        readings = [
            reading
            for reading in session.readings
            if reading != session.readings[-1] or f"reading {reading.reading}" in kept_numbers
        ]
        self._learn_from(readings)
        if len(readings) < len(session.readings):
            return self._departing(session.readings[-1])
        return None

    def _departing(self, reading: PostureReading) -> PostureDoubt | None:
        """A reading that departs; of another one is learnt."""
        only = self.session.only(reading)
        departure = self._expectation.departure(only)
        if departure is None or departure.is_doubtful:
            sliders_m = self.commands.sliders_mm / 1000.0
            other_readings = [
                (f"the platform in posture {number}", row)
                for number, row in enumerate(sliders_m, start=1)
                if number != reading.posture and not self.commands.procedure.whole().has_rigid_link
            ]
            return PostureDoubt(
                reading, departure, explanations(self._expectation, only, other_readings)
            )
        self._learn([reading])
        return None

    def _learn_from(self, readings: Sequence[PostureReading]) -> None:
        """All that the machine can have stood in, at once where one machine has all of them."""
        only = self.session.only
        possible = [reading for reading in readings if self._expectation.departure(only(reading))]
        if possible and not self._learn(possible):
            for reading in possible:
                self._learn([reading])

    def _learn(self, readings: Sequence[PostureReading]) -> bool:
        """Whether these tell of the next ones. A wrong one that counts by the operator's word may
        leave no machine that has all postures: measuring goes on without it.
        """
        readings_so_far = replace(self.session, readings=tuple(readings)).measurements().readings()
        try:
            self._expectation.learn(readings_so_far)
        except CalibrationError:
            return False
        return True


def _at_first(opened: PosturesOpened) -> Expectation:
    """What is expected before any reading."""
    machine = opened.machine.whole()
    procedure = opened.procedure.whole().on(machine)
    return Expectation(procedure, machine, opened.machine.tolerances.of(procedure.parameters))


def measure_simulated(taking: PostureTaking, seed: int, say: Callable[[str], None]) -> None:
    """Every posture that is left, by a simulated operator who takes a doubtful one again."""
    opened = taking.session.opened
    machine = SimulatedPostures(opened.machine, taking.commands, seed, opened.truth)
    while (number := taking.session.next_posture) is not None:
        readings = taking.session.all_readings
        attempt = sum(reading.posture == number for reading in readings)
        reading = taking.take(machine.typed(number, attempt))
        say(f"reading {reading.reading}: posture {reading.posture}: {reading.text}")
        if taking.doubt is not None:
            taking.take_again() if attempt == 0 else taking.keep()
    taking.finish()


def import_postures(
    source: Path, path: Path, opened: PosturesOpened
) -> tuple[PostureSession, tuple[str, ...]]:
    """A finished record of a table at ``path``, and what is odd about it.

    Raises RecordError for the table, naming line and column, and for the place of the record.
    """
    procedure = opened.procedure.model_copy(update={"postures": ()})
    opened = opened.model_copy(update={"procedure": procedure})
    readings, unused = readings_of_table(source, opened.machine, procedure)
    session = replace(fold_postures([opened, *readings.values()]), name=path.name)
    odd = _odd(source, session, [*readings])
    write_whole(path, opened, [*readings.values()], POSTURE_FORM)
    return session, (*unused, *odd)


def _odd(path: Path, session: PostureSession, lines: Sequence[int]) -> tuple[str, ...]:
    """What is odd about a table of postures, in words; ``lines`` are those of its readings.

    Raises RecordError where a posture cannot be of this machine: it names the line, the column and
    what else would explain it, a frame before all.
    """
    machine, expectation = session.opened.machine, _at_first(session.opened)
    odd: list[str] = []
    gross: list[tuple[int, PostureReading, Departure | None]] = []
    for line, reading in zip(lines, session.readings, strict=True):
        departure = expectation.departure(session.only(reading))
        if departure is None or departure.p_value < GROSS:
            gross.append((line, reading, departure))
        elif departure.is_doubtful:
            odd.append(f"line {line}, {departed(departure)}")
    if not gross:
        return tuple(odd)
    line, reading, departure = gross[0]
    column, value_words = _cell(session, reading, departure)
    subject = f"table {path}, line {line}, column {column}"
    possible = "sliders of a posture that the machine file has"
    if departure is not None:
        possible = f"what the machine file and its tolerances allow ({departed(departure)})"
    frame = None
    if len(gross) > 1 and all(way is not None for _, _, way in gross):
        frame = other_frame(session.measurements().readings(), machine.whole())
    if frame is not None:
        raise _of_another_frame(subject, frame, len(session.readings))
    ways = explanations(expectation, session.only(reading))
    turns = "turns in another order than Ry(theta) Rx(psi) Rz(phi), " if column in ANGLES else ""
    next_step = f"Look for a wrong unit, {turns}another machine file, or tolerances too small."
    if ways:
        next_step = f"As if: {'; '.join(ways)}."
    if len(gross) > 1:
        next_step += f" {len(gross)} of {len(session.readings)} rows are like that."
    raise RecordError(subject, value_words, possible, next_step)


def _of_another_frame(subject: str, frame: OtherFrame, count: int) -> RecordError:
    x, y, z = (1000.0 * frame.shifted_m).tolist()
    axis = ", ".join(f"{part:.5f}" for part in frame.axis.tolist())
    return RecordError(
        subject,
        "a pose of another frame",
        "poses in the base frame of the machine file",
        f"All {count} are as if turned by {frame.turned_deg:.4f}° about ({axis}), then shifted by "
        f"({x:.2f}, {y:.2f}, {z:.2f}) mm. Take that back, or set the tracker's frame so.",
    )


def _cell(
    session: PostureSession, reading: PostureReading, departure: Departure | None
) -> tuple[str, str]:
    """The column of a table that departs most, and the value in it; the sliders where no posture
    has them, or the length of a rigid link departs, which has no column.
    """
    values = dict(zip(session.opened.procedure.whole().measured, reading.values, strict=True))
    if departure is not None and departure.shown[0] in values:
        name, _, _, unit = departure.shown
        return name, f"{values[name]:.10g} {unit}"
    return "slider1 … slider6", f"{', '.join(f'{mm:.10g}' for mm in reading.sliders_mm)} mm"


def departed(departure: Departure) -> str:
    """``x is off by 3.2 mm, expected ± 0.5``: the value that differs most."""
    name, off, deviation, unit = departure.shown
    return f"{name} is off by {off:.4g} {unit}, expected ± {2.0 * deviation:.3g}"
