"""Do readings agree with the earlier repeats of their posture?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from protocols.events import Reading
from protocols.session import Session


@dataclass(frozen=True)
class Disagreement:
    """A reading further than the procedure allows from the mean of the earlier repeats, mm."""

    reading: Reading
    earlier_mean_mm: float
    earlier_count: int
    limit_mm: float

    @property
    def difference_mm(self) -> float:
        """The reading minus the mean of the earlier ones."""
        return self.reading.value_mm - self.earlier_mean_mm


def disagreements(session: Session, taken: Sequence[Reading]) -> tuple[Disagreement, ...]:
    """Which of the readings just taken are to be questioned.

    Compared are raw values of one mounting in one posture, so a stand that slipped shows too.
    """
    procedure = session.opened.procedure
    if procedure is None:
        return ()
    found = []
    for reading in taken:
        place = (reading.mount, reading.displacement_mm)
        earlier = [
            r.value_mm
            for r in session.readings
            if (r.mount, r.displacement_mm) == place and r.reading < reading.reading
        ]
        if earlier:
            mean = sum(earlier) / len(earlier)
            one = Disagreement(reading, mean, len(earlier), procedure.repeat_limit_mm)
            if abs(one.difference_mm) > one.limit_mm:
                found.append(one)
    return tuple(found)
