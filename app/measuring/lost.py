"""Indicators that gave no value: where their adapters are now, and whether the same ones answer."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from threading import Lock

from app.measuring.gauges import Gauge
from app.measuring.indicators import adapter_at, port_of
from drivers.profile import Fault, IndicatorReading


@dataclass(frozen=True)
class LostNews:
    """News of one indicator, counted from 0: its ``fault``, and the port where its adapter is now.

    Without a fault it answers again; ``adapters`` are those before and now, where they differ.
    """

    number: int
    fault: Fault | None = None
    elsewhere: str | None = None
    adapters: tuple[str, str] | None = None


class LostIndicators:
    """``ports`` are where the adapters of lost indicators are, if not where they were."""

    def __init__(self, gauges: Sequence[Gauge]) -> None:
        self._gauges, self._looking, self._looked_s = gauges, Lock(), 0.0
        self.ports: dict[int, str | None] = {}

    def is_due(self) -> bool:
        """Whether to look now: at once for what changed, from time to time for an adapter."""
        if self._looking.locked():
            return False
        outcomes = [gauge.live().outcome for gauge in self._gauges]
        changed = any(isinstance(o, Fault) is not (k in self.ports) for k, o in enumerate(outcomes))
        # while an indicator is lost the serial ports are looked at so often
        return changed or (bool(self.ports) and time.monotonic() - self._looked_s > 1.0)

    def look(self) -> list[LostNews]:
        """What changed since the last look. It takes as long as to list the ports."""
        with self._looking:
            self._looked_s = time.monotonic()
            return [news for k, gauge in enumerate(self._gauges) if (news := self._news(k, gauge))]

    def faults(self, numbers: Iterable[int]) -> list[LostNews]:
        """The indicators among these that are known to be lost, and give no value now either."""
        outcomes = [(k, self._gauges[k].live().outcome) for k in numbers if k in self.ports]
        return [LostNews(k, o, self.ports[k]) for k, o in outcomes if isinstance(o, Fault)]

    def _news(self, number: int, gauge: Gauge) -> LostNews | None:
        outcome = gauge.live().outcome
        if isinstance(outcome, Fault):
            where = port_of(gauge.adapter, gauge.port)
            if number in self.ports and self.ports[number] == where:
                return None
            self.ports[number] = where
            return LostNews(number, outcome, where)
        if number not in self.ports or not isinstance(outcome, IndicatorReading):
            return None
        del self.ports[number]
        adapter_before, now = gauge.adapter, adapter_at(gauge.port)
        if not adapter_before or now == adapter_before:
            return LostNews(number)
        gauge.adapter = now
        return LostNews(number, adapters=(adapter_before, now))
