"""Before the first reading: a hand pushes one spindle after the other, to see which is which."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from app.measuring.gauges import Live, Motion
from app.measuring.indicators import indicator_words
from drivers.profile import Reading
from protocols.machine import Instrument

PUSH_MM = 0.2
"""A push is further than this: less is somebody who touches the table."""

ALONE = 3.0
"""The spindle that is pushed moves so many times as far as the other."""

HELD_S = 5.0
"""What stays away so long is no push: the stand was moved."""

PushedIn = Literal["larger", "smaller"]


class Finding(StrEnum):
    """What the last push told."""

    NOTHING = "nothing yet"
    RIGHT = "the one that was asked for"
    OTHER = "another one"
    BOTH = "more than one"
    SIGN = "the other sign than stated"


@dataclass
class Trial:
    """Which spindle is asked for, and what was found.

    ``found`` tells for each indicator, counted from 0, what its reading became when its spindle was
    pushed in; ``last`` the same of the last push, whichever it was.
    """

    instruments: tuple[Instrument, ...]
    found: dict[int, PushedIn] = field(default_factory=dict)
    finding: Finding = Finding.NOTHING
    last: PushedIn = "larger"
    exchanged: bool = False
    _rest_mm: tuple[float, ...] = ()
    _away_mm: tuple[float, ...] = ()
    _moved_s: float = 0.0

    @property
    def done(self) -> bool:
        """Whether each indicator was found where it was asked for."""
        return len(self.found) == len(self.instruments)

    @property
    def asked(self) -> int:
        """The indicator whose spindle is to be pushed next."""
        return next((k for k in range(len(self.instruments)) if k not in self.found), 0)

    def look(self, states: Sequence[Live]) -> bool:
        """What the indicators show now. Returns whether a push came to its end."""
        shown = [live.outcome for live in states]
        values = tuple(one.value_mm for one in shown if isinstance(one, Reading))
        if self.done or len(values) < len(shown):
            return False
        still = all(live.motion is Motion.STABLE for live in states)
        if not self._rest_mm:
            return self._at_rest(values)
        now_mm = [value - rest for value, rest in zip(values, self._rest_mm, strict=True)]
        pairs = zip(self._away_mm, now_mm, strict=True)
        self._away_mm = tuple(max(pair, key=abs) for pair in pairs)
        if not still:
            self._moved_s = time.monotonic()
            return False
        furthest = max(map(abs, self._away_mm))
        if furthest < PUSH_MM or time.monotonic() - self._moved_s > HELD_S:
            return self._at_rest(values)
        if max(map(abs, now_mm)) > furthest / 2.0:
            return False  # still held
        self._judge()
        self._at_rest(values)
        return True

    def _at_rest(self, values: tuple[float, ...]) -> bool:
        """From here a push is counted. Returns that none has ended."""
        self._rest_mm, self._away_mm = values, (0.0,) * len(values)
        return False

    def _judge(self) -> None:
        """What the push that has just ended tells."""
        sizes = [abs(away) for away in self._away_mm]
        moved = sizes.index(max(sizes))
        self.last = "larger" if self._away_mm[moved] > 0.0 else "smaller"
        if any(ALONE * size > sizes[moved] for k, size in enumerate(sizes) if k != moved):
            self.finding = Finding.BOTH
        elif moved != self.asked:
            self.finding = Finding.OTHER
        elif self.instruments[moved].pushed_in not in (None, self.last):
            self.finding = Finding.SIGN
        else:
            self._found()

    def _found(self) -> None:
        self.finding = Finding.RIGHT
        self.found[self.asked] = self.last

    def exchange(self) -> None:
        """The hand was right, the ports are not: each indicator takes the axes of the other.

        From here on `look` wants their states in the other order.
        """
        first, second = self.instruments
        self.instruments = (
            second.model_copy(update={"axes": first.axes}),
            first.model_copy(update={"axes": second.axes}),
        )
        pushed, self.exchanged = self.asked, not self.exchanged
        self.found = {pushed: self.last}
        self.finding, self._rest_mm = Finding.RIGHT, ()

    def remark(self) -> str:
        """What goes into the record."""
        said = ["ports exchanged"] if self.exchanged else []
        for k, one in enumerate(self.instruments):
            way = self.found.get(k)
            told = f"pushed by hand, read {way} pushed in" if way else "not pushed by hand"
            said.append(f"{indicator_words(k, one)} {told}")
        return "before the first reading: " + "; ".join(said)

    def known(self) -> tuple[Instrument, ...]:
        """The indicators in their order, with what the pushes told of their sign."""
        return tuple(
            one.model_copy(update={"pushed_in": self.found.get(k, one.pushed_in)})
            for k, one in enumerate(self.instruments)
        )
