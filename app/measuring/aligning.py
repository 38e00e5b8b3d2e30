"""Between two rounds of measuring: which end of which rail to move, and how far it has moved."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from app.measuring.session import GuidedSession
from app.measuring.simulated import BenchSettings, simulated_session
from calib.errors import UsageError
from calib.tripod.alignment import (
    Alignment,
    RailMoved,
    Shim,
    aligned_geometry,
    alignment,
    shims,
    slope_at_zero_mm,
)
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from drivers.profile import IndicatorReading
from protocols.machine import Machine
from protocols.observations import indicator_figures, to_observations
from protocols.procedure import ALL_AXES, Leg, Procedure, Step
from protocols.session import Changed, Session

WATCHED = 0.9
"""Far from the tool end the leg moves most with its rail."""

LEAST_SHOWN = 0.05
"""Of a move: less cannot be watched at Zero, the carriage stands over the other end."""


@dataclass(frozen=True, eq=False)
class RailAlignment:
    """What a session tells of the rails, and the moves that make them square and meet."""

    machine: Machine
    reference: Leg
    alignment: Alignment
    shims: tuple[Shim, ...]

    @property
    def as_it_lies(self) -> Machine:
        """The machine with its drives as they lie, for a controller that is told of them."""
        drives = ALL_AXES.index(self.reference)
        geometry = aligned_geometry(
            self.machine.geometry(), self.alignment.lean_mrad, self.alignment.distance_mm, drives
        )
        return self.machine.with_drives_of(geometry)


def align_session(session: Session, reference: Leg) -> RailAlignment:
    """Raises UsageError where legs cannot be read, NotIdentifiable and RecordError."""
    machine, drive = session.opened.machine, ALL_AXES.index(reference)
    readings, figures = to_observations([session]), indicator_figures([session])
    tolerances_mm = machine.tolerances_mm()
    rails = alignment(machine.geometry(), readings, tolerances_mm, figures, drive)
    moves = shims(rails, drive, machine.rails_rest_mm())
    return RailAlignment(machine, reference, rails, tuple(moves))


def check_procedure(procedure: Procedure, machine: Machine, reference: Leg) -> None:
    """Raises as `align_session` where readings of a procedure would not tell of the rails."""
    nominal, scatter_mm = Model(machine.geometry()), BenchSettings().scatter_mm
    session = simulated_session(
        procedure, machine, nominal, seed=0, scatter_mm=scatter_mm, resolution_mm=0.0
    )
    align_session(session, reference)


class Watch(StrEnum):
    """What comes of the wish to watch a screw."""

    BEGUN = "watched"
    BLIND = "no turn of it shows at Zero"
    DONE = "its move is in the record"
    NO_NUMBER = "the indicator shows no number"


TURN_MM = 0.02
"""A key turns a simulated screw so that the end moves by so much."""


@dataclass
class Round:
    """One round of turning screws; ``moved_mm`` are the moves that are in the record."""

    guided: GuidedSession
    aligned: RailAlignment
    moved_mm: dict[int, float | None] = field(default_factory=dict)
    watching: bool = False
    number: int = 0
    _start_mm: float = 0.0

    @property
    def _geometry(self) -> Geometry:
        return self.aligned.machine.geometry()

    @property
    def shim(self) -> Shim:
        """The chosen screw."""
        return self.aligned.shims[self.number]

    @property
    def station(self) -> float:
        """Where on the bar the indicator watches the chosen screw."""
        return min(WATCHED, self._geometry.usable_bar[self.shim.rail][1])

    @property
    def watch_step(self) -> Step:
        """The set-up that watches it, at Zero. Raises UsageError where no indicator may."""
        towards = ALL_AXES[self.shim.towards]
        instruments = self.guided.session.opened.instruments
        fitting = [k for k, instrument in enumerate(instruments) if towards in instrument.axes]
        if not fitting:
            options = " and ".join(f"@{instrument.axes}" for instrument in instruments)
            raise UsageError("indicator that watches", options, f"one along {towards}")
        leg = ALL_AXES[self.shim.rail]
        # as over a plane: nothing is subtracted, the stand was there before the rail moved
        return Step(0, leg, 0.0, 1, self.station, (towards,), over_plane=True, first=fitting[0])

    @property
    def lever(self) -> float:
        """How much of a turn of the chosen screw shows on the leg at Zero."""
        return self.shim.shown(self._geometry, self.station)

    @property
    def watchable(self) -> bool:
        """Whether a turn of it shows."""
        return abs(self.lever) > LEAST_SHOWN

    def choose(self, by: int) -> Step:
        """So many screws on; tells a simulated machine to stand there. Raises as `watch_step`."""
        self.number = (self.number + by) % len(self.aligned.shims)
        self.guided.watch(self.watch_step)
        return self.watch_step

    def watch(self) -> Watch:
        """Begin to watch the chosen screw, or why not. Raises as `watch_step`, and RecordError."""
        if not self.watchable:
            return Watch.BLIND
        if self.number in self.moved_mm:
            return Watch.DONE
        value = self._value()
        if value is None:
            return Watch.NO_NUMBER
        rail = ALL_AXES[self.shim.rail]
        # from here on the record says that the machine is another one, whatever happens
        self.guided.change(Changed(rail=rail, reason=f"rail {rail} is being moved"))
        self.watching, self._start_mm = True, value  # where the screw begins
        return Watch.BEGUN

    def turn(self, way: int) -> bool:
        """Turn the chosen screw of a simulated machine by a key; not before it is watched."""
        if not self.watching or self.guided.turn is None:
            return False
        moved = RailMoved.by_shim(self.shim, way * TURN_MM)
        self.guided.turn(moved, self.watch_step)
        return True

    def live_mm(self) -> float | None:
        """How far the end that is watched has moved since; None where nothing is shown."""
        value = self._value() if self.watching else None
        return None if value is None else (value - self._start_mm) / self.lever

    def slope_mm(self) -> float:
        """Leg parallelism at Zero: how much further along the axis the foot is than the tool.

        That of the chosen screw, as the session found it, and as the ends of the rail moved since.
        """
        shim, moved_mm = self.shim, dict(self.moved_mm)
        if self.watching:
            moved_mm[self.number] = self.live_mm()
        way = slope_at_zero_mm(self.aligned.alignment.model, shim.rail, shim.towards)
        for k, mm in moved_mm.items():
            opposite = self.aligned.shims[k]
            if (opposite.rail, opposite.towards) == (shim.rail, shim.towards) and mm is not None:
                way += mm * opposite.shown(self._geometry, 1.0)
        return way

    def done(self, *, watched: bool) -> Changed:
        """Write the move into the record: what was read before is of another machine."""
        shim, moved = self.shim, self.live_mm() if watched else None
        change = Changed(
            rail=ALL_AXES[shim.rail],
            towards=ALL_AXES[shim.towards],
            support_mm=shim.support_mm,
            asked_mm=round(shim.move_mm, 4),
            moved_mm=None if moved is None else round(moved, 4),
            reason=f"rail {ALL_AXES[shim.rail]} moved",
        )
        self.guided.change(change)
        self.moved_mm[self.number], self.watching = moved, False
        return change

    def _value(self) -> float | None:
        """What the indicator shows that watches the chosen screw, mm."""
        outcome = self.guided.gauges[self.watch_step.first].live().outcome
        return outcome.value_mm if isinstance(outcome, IndicatorReading) else None
