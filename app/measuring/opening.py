"""From a plan to a session that can be measured: indicators that answer, and the record begun."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace

from app.measuring.demo import SelfMovingBench, SimulatedBench
from app.measuring.gauges import Gauge, Live, PushResult, SpindleCheck
from app.measuring.indicators import (
    adapter_before,
    asked_of,
    check_indicators,
    indicator_words,
    port_is_gone,
    profile_of,
    propose_again,
    this_computer,
)
from app.measuring.moving import Proves, open_mover
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession, Indicators
from app.version import program
from calib.errors import GlidecalError
from drivers.motion.line import STRICT, Patience
from protocols.journal import Journal
from protocols.procedure import Step
from protocols.record import read_record
from protocols.session import Opened


def open_indicators(plan: Plan) -> Indicators:
    """Open every port, all or none. Raises UsageError before, IndicatorError at a port."""
    check_indicators(plan.instruments, legs=bool(plan.procedure.levels))
    ports, address = tuple(instrument.port for instrument in plan.instruments), plan.motion
    interval_s, window_s = None, plan.procedure.window_s
    bench: SimulatedBench | SelfMovingBench | None = None
    with ExitStack() as undo:
        if plan.simulated:
            bench = SelfMovingBench(plan) if plan.by_itself else SimulatedBench(plan)
            undo.callback(bench.close)
            # how long simulated readings must stand still; real ones as the procedure says
            ports, interval_s, window_s = bench.ports, plan.interval_s, 0.4
        if isinstance(bench, SelfMovingBench):
            address = bench.controller.endpoint
        gauges = tuple(
            Gauge(
                profile_of(listed),
                port,
                asked_of(listed),
                interval_s=interval_s,
                window_s=plan.window_s or window_s,
                tolerance_mm=plan.procedure.tolerance_mm,
            )
            for port, listed in zip(ports, plan.instruments, strict=True)
        )
        for gauge in gauges:
            gauge.start()
            undo.callback(gauge.close)
        mover = None
        if address is not None:  # an empty name is refused, or a person would have to move
            hurried = plan.bench.motion_s == 0.0 and bench is not None
            # of a simulated machine in compressed time, which nobody attends
            patience = Patience(silence_s=3.0, dead_s=0.0) if hurried else STRICT
            proves: Proves = "never" if plan.simulated else "anew" if plan.prove else "once"
            wanted_set_up = plan.procedure, plan.machine, plan.instruments
            mover = open_mover(address, *wanted_set_up, gauges, patience, proves)
        undo.pop_all()
    if isinstance(bench, SimulatedBench):
        return Indicators(gauges, bench.go, bench.close, bench.turn)
    if bench and mover:
        mover.on_set_up = bench.set_up
        return Indicators(gauges, close_bench=bench.close, mover=mover)
    return Indicators(gauges, mover=mover)


def begin(plan: Plan, indicators: Indicators) -> GuidedSession:
    """Start the record of a plan, or go on with it. Raises RecordError or UsageError."""
    if plan.continued:
        journal = Journal.resume(plan.path, program())
    else:
        plan.procedure.steps(plan.machine.geometry(), plan.axes)
        plan.procedure.check_bars(plan.machine.geometry())
        journal = Journal.create(plan.path, opened_event(plan))
    guided = GuidedSession(journal, indicators, motion=plan.motion)
    if plan.note and not plan.continued:
        guided.note(plan.note)
    if not plan.simulated:
        propose_again(plan.machine, plan.instruments)
    return guided


@dataclass
class PlanCheck:
    """What an operator looks at before the record of a plan begins.

    ``problem`` is why the indicators did not open, ``absent`` those whose ports are not here,
    behind them the ones ``elsewhere``, to which another port was given: it may be a wrong one.
    ``spindles`` finds out which is which before the ``first`` step, where hands can push them.
    """

    plan: Plan
    problem: GlidecalError | None = None
    absent: list[int] = field(default_factory=list)
    elsewhere: list[int] = field(default_factory=list)
    spindles: SpindleCheck | None = None
    first: Step | None = None

    def open(self) -> Indicators | None:
        """Open the indicators; None where they do not, with the ``problem``."""
        try:
            return open_indicators(self.plan)
        except GlidecalError as problem:
            ports = enumerate(instrument.port for instrument in self.plan.instruments)
            missing = [k for k, port in ports if port_is_gone(port)]
            self.absent = [*missing, *(k for k in self.elsewhere if k not in missing)]
            self.problem = problem
        return None

    def find_spindles(self) -> None:
        """The indicators are open. Raises RecordError or UsageError where no step follows."""
        if (plan := self.plan).simulated:  # no hand can push those spindles
            return
        if plan.continued:
            self.first = read_record(plan.path).session.next_step()
        else:
            self.first = plan.procedure.steps(plan.machine.geometry(), plan.axes)[0]
        self.spindles = SpindleCheck(plan.instruments)

    def fits(self, answer: str, *, opened: bool) -> bool:
        """Whether to begin, try again, choose another port, or exchange both: another one moved."""
        spindles, refused = self.spindles, self.problem is not None
        moved = spindles is not None and spindles.finding is PushResult.OTHER
        able = {"retry": refused, "port": refused and bool(self.absent), "exchange": moved}
        return (able | {"begin": opened}).get(answer, True)

    def exchange(self, indicators: Indicators) -> Indicators:
        """The spindle that moved is the one that was asked for: its port belongs there."""
        assert self.spindles is not None, "exchangeable"
        self.spindles.exchange()
        if indicators.mover is not None:
            indicators.mover.exchange()
        return replace(indicators, gauges=indicators.gauges[::-1])

    def look(self, states: Sequence[Live]) -> tuple[bool, bool]:
        """Whether what is asked for changed by what the indicators show, and by a push."""
        if self.spindles is None:
            return False, False
        ready, pushed = self.spindles.ready, self.spindles.look(states)
        return pushed or self.spindles.ready is not ready, pushed

    @property
    def lost(self) -> tuple[str, str, list[str]]:
        """The first indicator whose port has gone in words, its adapter, and the ports in use."""
        number, instruments = self.absent[0], self.plan.instruments
        name, adapter = indicator_words(number, instruments[number]), instruments[number].port
        return name, adapter_before(adapter), [instrument.port for instrument in instruments]

    def read_at(self, port: str) -> None:
        """Read that indicator at another port."""
        number, instruments = self.absent[0], list(self.plan.instruments)
        self.elsewhere = [*(k for k in self.elsewhere if k != number), number]
        instruments[number] = instruments[number].model_copy(update={"port": port})
        self.plan = replace(self.plan, instruments=tuple(instruments))

    def begin(self, indicators: Indicators) -> GuidedSession:
        """Begin the session like `begin`, with what the pushes told of the indicators."""
        if self.spindles is not None:
            self.plan = replace(self.plan, instruments=self.spindles.known())
        return begin(self.plan, indicators)

    def remark(self, guided: GuidedSession) -> None:
        """Note in its record what the pushes told. Raises RecordError."""
        if self.spindles is not None:
            guided.note(self.spindles.remark())


def opened_event(plan: Plan) -> Opened:
    """The first line of the record."""
    return Opened(
        program=program(),
        origin="simulated" if plan.simulated else "measured",
        machine=plan.machine,
        procedure=plan.procedure,
        instruments=plan.instruments,
        seed=plan.seed if plan.simulated else None,
        operator=plan.operator,
        temperature_c=plan.temperature_c,
        verifies=plan.verifies,
        aligned_to=plan.reference,
        computer=None if plan.simulated else this_computer(),
    )


def start_session(plan: Plan, ask: Callable[[Indicators], None] = lambda _: None) -> GuidedSession:
    """Open the indicators, ``ask`` whether to begin, and begin.

    Raises IndicatorError, MotionError, RecordError or UsageError, and what ``ask`` raises.
    """
    indicators = open_indicators(plan)
    try:
        ask(indicators)
        return begin(plan, indicators)
    except BaseException:
        indicators.close()
        raise
