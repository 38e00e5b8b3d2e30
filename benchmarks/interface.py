"""The interface as an operator meets it, each figure beside its limit; part of ``make bench``.

The screens are drawn in full, escape sequences too; only the terminal is missing. Two simulated
indicators answer 20 times a second over their own ports, with a last digit that never rests.
"""

from __future__ import annotations

import asyncio
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from textual.pilot import Pilot
from textual.widgets import Tabs

from app.measuring.attended import IDLE_S
from app.measuring.demo import demo_plan
from app.measuring.gauges import Gauge
from app.measuring.indicators import profile_of
from app.measuring.opening import begin
from app.measuring.plan import Plan
from app.measuring.session import Indicators
from app.screens.interface import Glidecal
from app.screens.measure import MeasureScreen
from app.screens.result import ResultScreen
from app.screens.session_view import LegReviewScreen
from benchmarks.picture_delays import TICK_S, Blocked, Delays, Terminal, listening
from drivers.profile import Query, Spindle
from drivers.twins import IndicatorTwin, TwinPort, default_transport
from protocols.procedure import Step

ROOT = Path(__file__).parent.parent
SIZE = (120, 40)
INTERVAL_S = 0.05
WINDOW_S = 0.3
WAITING_S = 10.0
SETTLING_S = 1.0
CALM_S = 1.0
STARTS = 7
PATIENCE_S = 20.0
FIRST_WORDS = b"Demonstration"
ALTERNATE_SCREEN = b"\x1b[?1049h"
UNREST_MM = (0.0, 0.001, 0.002)
"""Each answer differs from the two before it, and all of them count as standing still."""

MOVING = 10.0
"""So many times that unrest is a movement."""


class Machine:
    """Two spindles that follow the steps at once and never quite rest."""

    def __init__(self, delays: Delays) -> None:
        self._delays = delays
        self._answers = [0, 0]
        self._base_mm = [0.0, 0.0]
        self.restless = True
        self.swing = 1.0

    def go(self, step: Step) -> None:
        """Deviations of about a millimetre, the same at every visit.

        Readings of the posture before it are in the table now and wanted on no display.
        """
        self._delays.give_up()
        self._base_mm = [0.1 + k + 0.004 * step.displacement_mm for k in range(2)]

    def spindle(self, index: int) -> Spindle:
        """What the twin of an indicator shows."""

        def position_mm() -> float:
            self._answers[index] += self.restless
            return self._base_mm[index] + self.swing * UNREST_MM[self._answers[index] % 3]

        return Spindle(position_mm, 0.001)


def open_indicators(plan: Plan, machine: Machine, undo: ExitStack) -> Indicators:
    """As `app.measuring.opening` does it, with spindles of our own."""
    gauges = []
    for index, instrument in enumerate(plan.instruments):
        profile = profile_of(instrument)
        twin = IndicatorTwin(profile, machine.spindle(index))
        port = undo.enter_context(TwinPort(twin, default_transport()))
        gauge = Gauge(
            profile,
            port.url,
            Query(),
            interval_s=INTERVAL_S,
            window_s=plan.window_s or plan.procedure.window_s,
            tolerance_mm=plan.procedure.tolerance_mm,
        )
        gauge.start()
        undo.callback(gauge.close)
        gauges.append(gauge)
    return Indicators(tuple(gauges), machine.go)


@dataclass(frozen=True)
class Share:
    """Of one core: what the process needs, and how much of that the simulated devices do."""

    all: float = 0.0
    devices: float = 0.0

    def __str__(self) -> str:
        return f"{self.all:.1%} of a core, {self.devices:.1%} of it the simulated devices"


@dataclass
class Figures:
    """Everything measured in one session; seconds and shares of one core."""

    moving_s: list[float] = field(default_factory=list)
    calm_s: list[float] = field(default_factory=list)
    waiting_s: list[float] = field(default_factory=list)
    taking_s: list[float] = field(default_factory=list)
    blocked_s: float = 0.0
    blocked_by_result_s: float = 0.0
    restless_share: Share = Share()
    still_share: Share = Share()


async def until(condition: Callable[[], bool]) -> None:
    """Wait for something on the screen. Raises TimeoutError."""
    async with asyncio.timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(TICK_S)


def devices_s() -> float:
    """CPU time of the threads of simulated devices."""
    clocks = getattr(time, "pthread_getcpuclockid", None)  # not on Windows
    twins = [t for t in threading.enumerate() if t.name.startswith("twin ") and t.ident]
    return sum(time.clock_gettime(clocks(t.ident)) for t in twins) if clocks else 0.0


async def cpu_share(delays: Delays, settling_s: float = SETTLING_S) -> Share:
    """The share of one core that waiting needs."""
    await asyncio.sleep(settling_s)
    delays.taken()
    wall, cpu_s, devices = time.perf_counter(), time.process_time(), devices_s()
    await asyncio.sleep(WAITING_S)
    wall = time.perf_counter() - wall
    return Share((time.process_time() - cpu_s) / wall, (devices_s() - devices) / wall)


def is_taken(screen: MeasureScreen, number: int) -> bool:
    """Whether a step is on the disk and the screen is ready for what comes next."""
    return number in screen.guided.session.done() and not screen.busy


async def take_every_step(pilot: Pilot[str], screen: MeasureScreen) -> None:
    """By hand: Space, and Space for the review of each leg; all but the last step."""
    for number in range(1, len(screen.guided.steps)):
        await until(lambda: not screen.busy and screen.attended.ready_by_hand())
        await pilot.press("space")
        await until(partial(is_taken, screen, number))
        if isinstance(screen.app.screen, LegReviewScreen):
            await pilot.press("space")
            await until(lambda: screen.app.screen is screen)


async def operate(
    interface: Glidecal, screen: MeasureScreen, machine: Machine, delays: Delays
) -> Figures:
    """Wait, take every step, see the result."""
    figures, blocked, closing = Figures(), Blocked(), Blocked()
    interface.driver_class = Terminal
    async with interface.run_test(headless=False, size=SIZE) as pilot:
        await until(lambda: interface.screen is screen)
        machine.swing = MOVING
        await cpu_share(delays)
        figures.moving_s = delays.taken()
        machine.swing = 1.0
        await asyncio.sleep(CALM_S + WINDOW_S)
        delays.taken()
        await asyncio.sleep(IDLE_S - 2.0 * CALM_S)
        figures.calm_s = delays.taken()
        figures.restless_share = await cpu_share(delays, 2.0 * CALM_S)
        figures.waiting_s = delays.taken()
        machine.restless = False
        figures.still_share = await cpu_share(delays)
        machine.restless = True
        await asyncio.sleep(SETTLING_S)
        delays.taken()
        async with blocked.watched():
            await take_every_step(pilot, screen)
        figures.taking_s = delays.taken()
        async with closing.watched():
            await until(screen.attended.ready_by_hand)
            await pilot.press("space")
            await until(lambda: isinstance(interface.screen, LegReviewScreen))
            await pilot.press("space")
            await until(lambda: isinstance(interface.screen, ResultScreen))
        # whole before it goes: Textual 8.2.8 fails where a screen of tabs goes half made
        await until(lambda: any(tabs.active for tabs in interface.screen.query(Tabs)))
    figures.blocked_s, figures.blocked_by_result_s = blocked.longest_s, closing.longest_s
    return figures


def measured_session() -> Figures:
    """The standard session on the screen, in a folder that is thrown away."""
    delays = Delays()
    machine = Machine(delays)
    with tempfile.TemporaryDirectory() as folder, listening(delays), ExitStack() as undo:
        demo = demo_plan(Path(folder), "zero-max-min", 1)
        plan = replace(demo, interval_s=INTERVAL_S, window_s=WINDOW_S)
        indicators = open_indicators(plan, machine, undo)
        guided = undo.enter_context(begin(plan, indicators))
        screen = MeasureScreen(guided, plan)
        interface = Glidecal(screen)
        interface.guided = guided
        return asyncio.run(operate(interface, screen, machine, delays))


def first_screen_s() -> float:
    """From the start of the process to the words of the home screen, in a pseudo-terminal."""
    import fcntl
    import struct
    import termios

    own_end, far_end = os.openpty()
    fcntl.ioctl(far_end, termios.TIOCSWINSZ, struct.pack("HHHH", SIZE[1], SIZE[0], 0, 0))
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(ROOT)}
        start = time.perf_counter()
        with subprocess.Popen(
            [sys.executable, "-m", "app"],
            stdin=far_end,
            stdout=far_end,
            stderr=far_end,
            cwd=folder,
            env=environment,
            start_new_session=True,
        ) as process:
            os.close(far_end)
            output = b""
            while ALTERNATE_SCREEN not in output or FIRST_WORDS not in output:
                output += os.read(own_end, 1 << 16)
            seconds = time.perf_counter() - start
            process.kill()
    os.close(own_end)
    return seconds


def unattended_s() -> float:
    """The whole demonstration: measure, identify, export, measure again."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        subprocess.run(
            [sys.executable, "-m", "app", "demo", "--headless", "--folder", folder],
            capture_output=True,
            check=True,
            cwd=ROOT,
        )
        return time.perf_counter() - start


def delay_row(when: str, delays_s: list[float], limit: str = "p99 ≤ 50 ms") -> str:
    """Median and 99th percentile of the delays."""
    ms = [1e3 * value for value in statistics.quantiles(delays_s, n=100)]
    figures = f"median {ms[49]:.1f}, p99 {ms[98]:.1f} ms, n = {len(delays_s)}"
    return f"| reading → screen, {when} | {figures} | {limit} |"


def interface() -> list[str]:
    """The table, each figure beside its limit."""
    delays = measured_session()
    rows = [
        delay_row("moving", delays.moving_s),
        delay_row("taking steps", delays.taking_s),
        delay_row("at rest, last digit changing", delays.calm_s),
        delay_row(f"the same after {IDLE_S:g} s at rest", delays.waiting_s, "–"),
    ]
    if os.name == "posix":
        start_s = statistics.median(first_screen_s() for _ in range(STARTS))
        rows.append(f"| start → home screen, whole process | {start_s:.2f} s | ≤ 1.0 s |")
    return [
        "| interface, 120 × 40 with plots, 2 × 20 readings/s | measured | limit |",
        "|---|---|---|",
        *rows,
        f"| event loop blocked, taking steps | {delays.blocked_s * 1e3:.0f} ms | ≤ 100 ms |",
        f"| event loop blocked, record → result | {delays.blocked_by_result_s * 1e3:.0f} ms | – |",
        f"| CPU while waiting, last digit changing | {delays.restless_share} | ≤ 5 % |",
        f"| CPU while waiting, readings at rest | {delays.still_share} | ≤ 5 % |",
        f"| standard session twice, `demo --headless` | {unattended_s():.2f} s | ≤ 10 s |",
    ]


if __name__ == "__main__":
    print("\n".join(interface()))
