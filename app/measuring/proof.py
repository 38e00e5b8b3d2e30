"""Whether a controller moves each carriage as the machine file says: proved by short moves.

Nothing longer moves before. Each carriage goes 5 mm and back, slowly, with a consent of its own,
while the indicators stand at the first set-up: they tell carriage and scale. What they cannot tell
the operator is asked for: the carriage along the leg, and the direction where an indicator goes
against it, for an indicator may be held so that it counts against.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from app.settings import data_path
from calib.errors import MotionError, RecordError, UsageError
from drivers.motion.controller import ControllerFault, Limits, Triple, place_words
from protocols.carriages import Change, changes, is_allowed, moved_alone
from protocols.documents import Document, Name, read_remembered
from protocols.files import write_files
from protocols.machine import Instrument, Machine
from protocols.procedure import ALL_AXES, Leg, Step

FEED_MM_MIN = 120.0
"""Of a proof: an inch for a mm is 50 mm/s then, and stopped within a centimetre or two."""

WAYS_MM = (5.0, -5.0, 2.0, -2.0, 1.0, -1.0)
"""The first of these that limits and indicators allow."""


SEEN = 0.1
"""An indicator tells the scale of a move where it is known better than to this part."""

MOTION_KEYS = {"mdi", "joints", "drive", "leg_length_mm"}
"""What of a machine file says which carriage goes where."""


DIRECTION = "the direction of this joint at the controller"
ORDER = "the order of the joints at the controller"
SCALE = "the scale of this joint at the controller, or its unit"


class ProvedMachines(Document):
    """The machines that were proved, by name, each with a digest of file and controller."""

    machines: dict[Name, str] = Field(default_factory=dict)


@dataclass(frozen=True)
class ProofMove:
    """One carriage, so far along its rail and back, and what each indicator shows of it.

    The indicators are set up as for ``step``.
    """

    step: Step
    carriage: Leg
    way_mm: float
    from_mm: Triple
    to_mm: Triple
    due: tuple[Change, ...]

    @property
    def words(self) -> str:
        """What moves, how far and which way: seen from the platform its carriage is outward."""
        return f"carriage {self.carriage.upper()} {self.way_words}"

    @property
    def way_words(self) -> str:
        """How far and which way."""
        way = "outward, from the platform" if self.way_mm > 0.0 else "inward, to the platform"
        return f"{abs(self.way_mm):g} mm {way}"

    @property
    def clearest(self) -> int | None:
        """The indicator that tells the scale best; None where none tells it."""
        sure = [change.within_mm / max(abs(change.nominal_mm), 1e-9) for change in self.due]
        best = min(range(len(sure)), key=sure.__getitem__)
        return best if sure[best] <= SEEN else None


class Proof:
    """What one machine file and one controller have proved, carriage after carriage.

    ``wrong`` is why the last attempt failed, with what to do; ``question`` is put to the operator;
    ``news`` are for the record; ``stands``: the indicators stand where they were set up for it.
    Proved anew where ``anew``, whatever is remembered.
    """

    def __init__(
        self,
        machine: Machine,
        limits: Limits,
        instruments: Sequence[Instrument],
        controller: str,
        *,
        anew: bool = False,
    ) -> None:
        self.wrong = self.question = ""
        self.news: list[str] = []
        self.move: ProofMove | None = None
        self.stands = False
        self._machine, self._limits = machine, limits
        self._identity = f"{controller}\n{machine.model_dump_json(include=MOTION_KEYS)}"
        self._instruments = tuple(instruments)
        self._left = list(ALL_AXES)
        self._place: object = None
        self._rest_mm: tuple[float, ...] = ()
        self._proved = self._doubt = ""
        with suppress(RecordError):  # then it is proved again
            self._proved = "" if anew else _remembered().machines.get(machine.name, "")

    def exchange(self) -> None:
        """Each indicator is at the port of the other."""
        self._instruments = self._instruments[::-1]

    def needed(self, facts: Sequence[str]) -> bool:
        """Whether this machine behind this controller, which reports these facts, is unproved."""
        return self._proved != self._digest(facts)

    def _digest(self, facts: Sequence[str]) -> str:
        return hashlib.sha256("\n".join([self._identity, *facts]).encode()).hexdigest()

    def sets_up(self, step: Step) -> bool:
        """Whether the indicators are to be set up first, where the machine is."""
        return self._place != step.place

    def next_move(self, step: Step, place_mm: Triple) -> ProofMove:
        """The next carriage's move from here. Raises MotionError where none fits."""
        carriage = self._left[0]
        for way_mm in WAYS_MM:
            to_mm = moved_alone(place_mm, carriage, way_mm, self._machine)
            if to_mm is None or not self._fits(place_mm, to_mm):
                continue
            due = changes(step, place_mm, to_mm, self._machine)
            if all(map(self._within_travel, step.indicators, due)):
                return ProofMove(step, carriage, way_mm, place_mm, to_mm, due)
        raise MotionError(
            f"carriage {carriage.upper()} at {place_words(place_mm)}",
            "no room for 1 mm within the limits of the machine file",
            "a machine inside its limits, in the coordinates that mdi names",
            "Jog it there at the controller, or correct mdi in the machine file.",
        )

    def _fits(self, from_mm: Triple, to_mm: Triple) -> bool:
        with suppress(ControllerFault):
            self._limits.check(to_mm, min(FEED_MM_MIN, self._limits.fastest_mm_min))
            self._limits.check_way(from_mm, to_mm)
            return is_allowed(to_mm, self._machine)
        return False

    def _within_travel(self, number: int, change: Change) -> bool:
        travel_mm = self._instruments[number].travel_mm
        # an indicator goes no further than this part of its travel: it stands about the middle
        return travel_mm is None or abs(change.nominal_mm) <= 0.4 * travel_mm

    def begin(self, move: ProofMove, shown_mm: tuple[float, ...]) -> None:
        """The move is consented to; the indicators rest and show this."""
        self.wrong = self._doubt = ""
        self.move, self._rest_mm, self._place = move, shown_mm, move.step.place
        self.stands = True

    def beyond(self, shown_mm: Sequence[float]) -> bool:
        """Whether an indicator went further than this move can take it: it must be stopped."""
        assert self.move is not None
        gone_mm, move = self._gone_mm(shown_mm), self.move
        over_mm = [
            abs(way) - abs(due.nominal_mm) - due.within_mm
            for way, due in zip(gone_mm, move.due, strict=True)
        ]
        worst = over_mm.index(max(over_mm))
        if over_mm[worst] <= 0.0:
            return False
        if worst == move.clearest:
            reason, where = "it goes too far; an inch for a mm is 25.4 times", SCALE
        else:
            due_of_others = {
                name: self._due_of(name, move) for name in ALL_AXES if name != move.carriage
            }
            likeliest = max(
                due_of_others, key=lambda name: abs(due_of_others[name][worst].nominal_mm)
            )
            reason, where = f"carriage {likeliest.upper()} moves in its place", ORDER
        self._fail(f"{reason}: {_ways_words(move, gone_mm)}", where)
        return True

    def there(self, shown_mm: Sequence[float]) -> bool:
        """Whether the indicators went as far as they were to; else it is wrong."""
        move = self.move
        assert move is not None
        gone_mm = self._gone_mm(shown_mm)
        if not _near(move.due, gone_mm):
            self._fail(*self._reason(move, gone_mm))
            return False
        best = move.clearest
        if best is None:
            self._doubt = "The indicators cannot show this move."
        elif gone_mm[best] * move.due[best].nominal_mm < 0.0:
            self._doubt = (
                "Its indicator moved the other way: it is mounted so, or the carriage did."
            )
        self.news.append(f"proof: {move.words}: {_ways_words(move, gone_mm)}")
        return True

    def back(self, shown_mm: Sequence[float]) -> None:
        """End the proof at its beginning: passed if all indicators are back, too."""
        move = self.move
        assert move is not None
        gone_mm = self._gone_mm(shown_mm)
        if any(abs(w) > due.within_mm for w, due in zip(gone_mm, move.due, strict=True)):
            ways = ", ".join(f"{way:+.3f} mm" for way in gone_mm)
            self._fail(
                f"back, the indicators are off by {ways}", "the obstacle on its way, or its play"
            )
            return
        self.move = None
        if self._doubt:
            alone = f"Did carriage {move.carriage.upper()} alone move {move.way_words}"
            self.question = f"{self._doubt} {alone}, and come back?"
        else:
            del self._left[0]

    def answer(self, *, yes: bool) -> None:
        """What the operator saw."""
        question, self.question = self.question, ""
        self.news.append(f"proof: {question} {'yes' if yes else 'no'}")
        if yes:
            del self._left[0]
        else:
            self._fail(f"the operator did not see {question.partition('Did ')[2]}", DIRECTION)

    def drop(self) -> None:
        """The move was stopped: it begins anew."""
        self.move, self.question = None, ""

    def finish(self, facts: Sequence[str]) -> None:
        """Remember the machine once every carriage is proved."""
        if self._left:
            return
        self._left = list(ALL_AXES)
        self.news.append("proof: direction, order and scale of every carriage are as the file says")
        self.remember(facts)

    def remember(self, facts: Sequence[str]) -> None:
        """The machine counts as proved behind this controller."""
        self._proved = self._digest(facts)
        with suppress(RecordError, UsageError):  # then it is proved again the next time
            machines = _remembered().machines | {self._machine.name: self._proved}
            text = ProvedMachines(machines=machines).model_dump_json(indent=1)
            write_files(proved_path(), {"": text}, replace=True)

    def _gone_mm(self, shown_mm: Sequence[float]) -> list[float]:
        return [
            value_mm - rest_mm for value_mm, rest_mm in zip(shown_mm, self._rest_mm, strict=True)
        ]

    def _reason(self, move: ProofMove, gone_mm: Sequence[float]) -> tuple[str, str]:
        """Why the indicators did not go far enough, and what is to be corrected."""
        ways, best = _ways_words(move, gone_mm), move.clearest
        for name_beside in ALL_AXES:
            if name_beside != move.carriage and _near(self._due_of(name_beside, move), gone_mm):
                return (
                    f"carriage {name_beside.upper()} moved in its place, or none did: {ways}",
                    ORDER,
                )
        if best is None:
            return ways, ORDER
        ratio = abs(gone_mm[best] / move.due[best].nominal_mm)
        return f"it went {ratio:.2f} times as far: {ways}", SCALE

    def _due_of(self, letter: Leg, move: ProofMove) -> tuple[Change, ...]:
        """What the indicators would show if another carriage moved in its place."""
        to_mm = moved_alone(move.from_mm, letter, move.way_mm, self._machine) or move.from_mm
        return changes(move.step, move.from_mm, to_mm, self._machine)

    def _fail(self, text: str, where: str) -> None:
        """Not proved: all of it begins anew, with the indicators set up."""
        prefix = f"Sent {self.move.words}: " if self.move else ""
        self.wrong = (
            f"{prefix}{text}. Correct {where}, or mdi in the machine file, or move the stand to "
            "its station."
        )
        self.news.append(f"proof failed: {self.wrong}")
        self._left, self._place = list(ALL_AXES), None
        self.drop()


def _near(due: Sequence[Change], gone_mm: Sequence[float]) -> bool:
    return all(change.is_near(way) for change, way in zip(due, gone_mm, strict=True))


def _ways_words(move: ProofMove, gone_mm: Sequence[float]) -> str:
    """How far the indicators went, and how far they were to."""
    ways = ", ".join(f"{way:+.3f}" for way in gone_mm)
    due = ", ".join(f"{change.nominal_mm:+.3f}" for change in move.due)
    return f"indicators {ways} mm, expected {due} mm"


def proved_path() -> Path:
    """Where proved machines are remembered."""
    return data_path().with_name("machines.json")


def _remembered() -> ProvedMachines:
    """Raises RecordError for a file that cannot be read."""
    return read_remembered(proved_path(), ProvedMachines, "machines proved,")
