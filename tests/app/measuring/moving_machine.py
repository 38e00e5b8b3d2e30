"""A machine that moves itself behind a simulated controller, read by indicators that follow it.

What they show follows from where the controller believes the carriages to be at that very moment,
by the geometry of `tests.controller.machine`, which shares no code with the program: a reading
that was taken elsewhere, or on the way, is a wrong one. Run as a program it draws many faults.
"""

from __future__ import annotations

import random
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from app.measuring.gauges import Gauge
from app.measuring.moving import MoveProposal, Mover, limits_of, open_mover
from app.measuring.plan import Plan
from app.measuring.session import GuidedSession, Indicators
from app.measuring.unattended import lost_words, measure_all
from calib.errors import GlidecalError
from drivers.motion import controller_of
from drivers.motion.controller import Triple
from drivers.motion.line import MotionLine
from drivers.motion.states import State
from drivers.profile import Profile, Query, Spindle
from drivers.profiles.mitutoyo_01a import MITUTOYO_01A
from drivers.twins import IndicatorTwin, TwinPort
from protocols.journal import Journal
from protocols.machine import Instrument, MotionLimits
from protocols.machine import Machine as MachineFile
from protocols.procedure import Procedure, Step, load_procedure
from protocols.record import read_record
from protocols.session import Opened, Reading, fold
from tests.controller.machine import L, Machine
from tests.drivers.motion.bench import BUSY
from tests.drivers.motion.twins import FailingAxes, FailingLinuxCnc, MotionTrouble, MotionTwin
from tests.end_to_end.test_hang_up import Terminal

FAST = MachineFile(motion=MotionLimits(feed_mm_min=30_000.0), fastest_feed_mm_min=60_000.0)
SLOWER = MachineFile(motion=MotionLimits(feed_mm_min=9_000.0), fastest_feed_mm_min=60_000.0)
MOST_TRIES = 60
SHORT = load_procedure("zero-max-min", FAST.geometry()).model_copy(
    update={"cycles": 1, "legs": ("x", "y")}
)
HIDDEN = Machine((0.8, -1.3, 0.45))
STEP_MM = 0.001
PROMPT = replace(MITUTOYO_01A, timeout_s=0.4)
"""A missing answer is noticed earlier than with the profile's own five seconds: where one is to be
missed only, for a busy machine lets answers wait so long, too."""

STOP_S = 0.5
QUESTION = b"[y/N]: "


def carriages(tool: Triple) -> list[float]:
    """Of an Orthoglide without errors: foot i on axis i, the far one."""
    square = [sum(tool[k] ** 2 for k in range(3) if k != i) for i in range(3)]
    return [float(tool[i] + np.sqrt(L**2 - square[i])) for i in range(3)]


NOMINAL = Machine()


def linuxcnc(axes: FailingAxes) -> MotionTwin:
    """A LinuxCNC that takes tool coordinates."""
    return FailingLinuxCnc(axes, "tool")


class Bench:
    """Two indicators on the leg that is set up, and the machine behind its controller.

    ``wired`` gives where carriages are for where the controller believes them; an indicator of sign
    -1 is held so that it counts against.
    """

    def __init__(
        self, axes: FailingAxes, machine: Machine = HIDDEN, coordinates: str = "tool"
    ) -> None:
        self.axes, self.machine, self._coordinates = axes, machine, coordinates
        self.leg, self.along, self.station = 0, (1, 2), 0.5
        self.unplugged = False
        self.wired: Callable[[list[float]], list[float]] = list
        self.signs = (1.0, 1.0)

    def set_up(self, step: Step) -> bool:
        """What the operator does by hand."""
        self.leg, self.station = "xyz".index(step.leg), step.station
        self.along = ("xyz".index(step.axes[0]), "xyz".index(step.axes[1]))
        return True

    def agree(self, proposal: MoveProposal) -> bool:
        """The operator's consent, after what is to be set up by hand."""
        return not proposal.by_hand or self.set_up(proposal.step)

    @property
    def tool_mm(self) -> Triple:
        """Where the controller believes the tool."""
        if self._coordinates == "tool":
            return self.axes.at_mm
        x, y, z = NOMINAL.tool(self.axes.at_mm).tolist()
        return x, y, z

    def shows_mm(self, number: int) -> float:
        value_mm = self.reading_mm(self.leg, self.along[number], self.station, self.tool_mm)
        return self.signs[number] * value_mm

    @property
    def carriages_mm(self) -> list[float]:
        """Where the carriages are, but for what is hidden."""
        return self.wired(carriages(self.tool_mm))

    def reading_mm(self, leg: int, axis: int, station: float, tool: Triple) -> float:
        offset = np.array(self.machine.offset_mm)
        now, zero = np.array(self.wired(carriages(tool))) + offset, np.full(3, L) + offset
        return self.machine.reading(leg, axis, station, now.tolist(), zero.tolist())


class Unpluggable:
    """A twin whose cable may be pulled for a while."""

    def __init__(self, bench: Bench, number: int) -> None:
        spindle = Spindle(lambda: bench.shows_mm(number), STEP_MM)
        self._bench, self._twin = bench, IndicatorTwin(MITUTOYO_01A, spindle)

    def receive(self, request: bytes) -> bytes:
        answer = self._twin.receive(request)
        return b"" if self._bench.unplugged else answer


@contextmanager
def following(
    make: Callable[[FailingAxes], MotionTwin] = linuxcnc,
    coordinates: str = "tool",
) -> Iterator[tuple[Bench, MotionTwin, tuple[str, ...]]]:
    """A machine behind a controller, and the ports of two indicators that follow it."""
    with ExitStack() as stack:
        x, y, z = (3.0, -2.0, 1.0) if coordinates == "tool" else carriages((3.0, -2.0, 1.0))
        twin = make(FailingAxes((x, y, z)))
        stack.callback(twin.close)
        bench = Bench(twin.axes, coordinates=coordinates)
        ports = [
            stack.enter_context(TwinPort(Unpluggable(bench, number), "tcp")) for number in range(2)
        ]
        yield bench, twin, tuple(port.url for port in ports)


@contextmanager
def moving_session(
    path: Path,
    machine: MachineFile = FAST,
    procedure: Procedure = SHORT,
    make: Callable[[FailingAxes], MotionTwin] = linuxcnc,
    window_s: float = 0.06,
    profile: Profile = MITUTOYO_01A,
) -> Iterator[tuple[GuidedSession, Bench, MotionTwin]]:
    opened = Opened(
        program="test",
        origin="measured",
        machine=machine,
        procedure=procedure,
        instruments=(Instrument(profile="mitutoyo-01a"),) * 2,
    )
    with ExitStack() as stack:
        bench, twin, ports = stack.enter_context(following(make, machine.mdi))
        gauges = []
        for port in ports:
            gauge = Gauge(
                profile,
                port,
                Query(),
                interval_s=0.01,
                window_s=window_s,
                tolerance_mm=0.004,
            )
            gauge.start()
            gauges.append(gauge)
        controller = controller_of(twin.endpoint, limits_of(machine))
        controller.answer_s = 2.0
        mover = Mover(MotionLine(controller, BUSY), procedure, machine, ("xyz", "xyz"), gauges)
        mover.line.start()
        mover.line.homing_confirmed = True
        is_continued = path.exists()
        journal = Journal.resume(path, "test") if is_continued else Journal.create(path, opened)
        with GuidedSession(journal, Indicators((*gauges,), mover=mover)) as guided:
            yield guided, bench, twin


def remember_proved(plan: Plan) -> None:
    """The machine of a plan behind its controller counts as proved from now on."""
    assert plan.motion is not None
    mover = open_mover(
        plan.motion, plan.procedure, plan.machine, plan.instruments, (), BUSY, "once"
    )
    assert mover.proof is not None
    mover.proof.remember(mover.line.facts)
    mover.line.close()


def taken(path: Path) -> tuple[Reading, ...]:
    """The readings that count."""
    return fold(read_record(path).events).readings


def wrong(readings: tuple[Reading, ...], bench: Bench) -> list[str]:
    """Readings that are not those of the posture that the record says."""
    problems = []
    for reading in readings:
        leg, axis = "xyz".index(reading.leg), "xyz".index(reading.axis)
        tool = [0.0, 0.0, 0.0]
        tool[leg] = reading.displacement_mm
        right = bench.reading_mm(leg, axis, reading.station, (tool[0], tool[1], tool[2]))
        if abs(reading.value_mm - right) > STEP_MM:
            problems.append(f"step {reading.step}: {reading.value_mm} for {right:.4f}")
    return problems


TROUBLES = (
    MotionTrouble.ESTOP,
    MotionTrouble.FOLLOWING,
    MotionTrouble.NAK,
    MotionTrouble.HANG_UP,
    MotionTrouble.SILENCE,
    MotionTrouble.ELSEWHERE,
    MotionTrouble.DIED,
    "indicator",
    "moved by hand",
    "stop",
)


def befall(trouble: str, guided: GuidedSession, bench: Bench, twin: MotionTwin) -> None:
    if trouble == "indicator":
        bench.unplugged = True
    elif trouble == "moved by hand":
        x, y, z = bench.axes.at_mm
        bench.axes.go((x + 0.4, y, z), 1e6)
    elif trouble == "stop":
        assert guided.mover is not None
        guided.mover.stop("the operator")
    else:
        twin.befall(MotionTrouble(trouble))


def with_faults(
    path: Path,
    seed: int,
    draws: int,
    machine: MachineFile = SLOWER,
    make: Callable[[FailingAxes], MotionTwin] = linuxcnc,
    troubles: Sequence[str] = TROUBLES,
    latest_s: float = 2.0,
) -> tuple[list[str], list[tuple[float, str]], int]:
    """A session with a fault at each of so many random moments, mended and continued each time.

    What is wrong, how long the machine went on after each fault, and how many faults were met.
    """
    chance = random.Random(seed)
    stops_s: list[tuple[float, str]] = []
    count = 0
    tries = 0
    order = chance.sample(troubles, len(troubles))
    profile = PROMPT if "indicator" in troubles else MITUTOYO_01A
    with moving_session(path, machine, make=make, profile=profile) as (guided, bench, twin):
        while guided.step() is not None:
            tries += 1
            assert tries < MOST_TRIES, guided.mover and guided.mover.why
            timer: threading.Timer | None = None
            if count < draws:
                trouble = order[count % len(order)]
                went_on: list[tuple[float, str]] = []

                def strike(
                    trouble: str = trouble, went_on: list[tuple[float, str]] = went_on
                ) -> None:
                    befall(trouble, guided, bench, twin)
                    began = time.monotonic()
                    while bench.axes.moving and time.monotonic() - began < 5.0:
                        time.sleep(0.002)
                    went_on.append((time.monotonic() - began, str(trouble)))

                timer = threading.Timer(chance.uniform(0.05, latest_s), strike)
                timer.start()
            try:
                measure_all(guided, bench.agree, lambda _: None)
            except GlidecalError:
                if timer is not None:
                    timer.join()
                    count += 1
                    stops_s += went_on
            else:
                if timer is not None:
                    timer.cancel()
                    timer.join()
            twin.mend()
            bench.unplugged = False
            operator_looks(guided)
    return wrong(taken(path), bench), stops_s, count


def operator_looks(guided: GuidedSession) -> None:
    """Waits for the indicators, vouches for what was not seen to stop, and answers the rest."""
    end = time.monotonic() + 20.0
    while lost_words(guided) and time.monotonic() < end:
        time.sleep(0.05)
    assert guided.mover is not None
    mover = guided.mover
    while time.monotonic() < end and mover.state in (
        State.STOPPING,
        State.HELD,
        State.FAULT,
    ):
        if mover.line.not_stopped:
            mover.line.vouch()
        elif mover.state is not State.STOPPING:
            mover.answer().exception(20.0)
            mover.line.homing_confirmed = True
        time.sleep(0.05)


class Answering(Terminal):
    """Its operator says yes to each question as it appears: may it move, is it set up?"""

    _answered = 0

    def until(self, condition: Callable[[], bool]) -> None:
        def holds() -> bool:
            if self.shown.count(QUESTION) > self._answered:
                self._answered += 1
                self.press(b"y\n")
            return condition()

        super().until(holds)


def killed_and_continued(
    folder: Path,
    seed: int,
    kills: int,
    feed: float,
    make: Callable[[FailingAxes], MotionTwin] = linuxcnc,
) -> dict[str, object]:
    """`glidecal run --motion` in a terminal, killed at random moments, each time continued."""
    chance, path, window_s = random.Random(seed), folder / "a.jsonl", 0.1
    (folder / "machine.toml").write_text(
        f'schema = "glidecal.machine/1"\nfastest_feed_mm_min = 60000.0\n'
        f"[motion]\nfeed_mm_min = {feed}\n"
    )
    (folder / "short.toml").write_text(f"{ONE_LEG}window_s = {window_s}\n")
    stops_s, counts = [], []
    with following(make) as (bench, twin, ports):
        usual = ["run", "--headless", "--motion", twin.endpoint]
        for port, axes in zip(ports, ("yzx", "zxy"), strict=True):
            usual += ["--indicator", f"mitutoyo-01a:{port}@{axes}"]
        either = (Instrument(profile="mitutoyo-01a"),) * 2
        remember_proved(Plan(path, FAST, SHORT, either, motion=twin.endpoint))
        new = ["--machine", "machine.toml", "--protocol", "short.toml", "-o", "a.jsonl"]
        for life in range(kills + 1):
            terminal = Answering(folder, *usual, *(new if life == 0 else ["--continue", "a.jsonl"]))
            if life == kills:
                terminal.until(terminal.ended)
                break
            terminal.until(lambda: bench.axes.moving)
            after_s = time.monotonic() + chance.uniform(0.0, 2.0)

            def moves_later(after_s: float = after_s) -> bool:
                return time.monotonic() > after_s and bench.axes.moving

            terminal.until(moves_later)
            terminal.process.kill()
            began = time.monotonic()
            while bench.axes.moving and time.monotonic() - began < 20.0:
                time.sleep(0.002)
            stops_s.append(time.monotonic() - began)
            terminal.process.wait()
            terminal.close()
            counts.append(len(taken(path)))
        assert terminal.process.returncode == 0, terminal.shown[-2000:]
        problems = wrong(taken(path), bench)
        terminal.close()
    record = read_record(path)
    return {
        "wrong": problems,
        "readings": len(taken(path)),
        "kept": counts,
        "end": record.end,
        "longest_stop_s": max(stops_s),
    }


ONE_LEG = """schema = "glidecal.procedure/1"
name = "short"
title = "Both directions, one leg"
legs = ["x"]
cycles = 1
levels = ["zero", 22.0, 60.0, 22.0, -100.0]
"""


def main() -> None:
    """Faults at random moments, as many as asked for: what is wrong, and how long they took.

    One in seven of them kills the program itself.
    """
    goal, count, seed = int(sys.argv[1]), 0, 0
    kills = goal // 7
    stops_s: list[tuple[float, str]] = []
    while count < goal - kills:
        seed += 1
        problems, stopped, struck = with_faults(Path(mkdtemp()) / "a.jsonl", seed, 12)
        count, stops_s = count + struck, stops_s + stopped
        print(
            f"session {seed}: {struck} faults, {len(problems)} wrong readings {problems}",
            flush=True,
        )
    while kills > 0:
        seed += 1
        summary = killed_and_continued(Path(mkdtemp()), seed, min(kills, 7), 3000.0)
        count, kills = count + min(kills, 7), kills - 7
        stops_s.append((float(str(summary["longest_stop_s"])), "killed"))
        print(f"session {seed}: {summary}", flush=True)
    longer = sorted(f"{name} {s:.2f} s" for s, name in stops_s if s > STOP_S)
    print(f"{count} faults, longest {max(stops_s)}, longer than {STOP_S} s: {', '.join(longer)}")


if __name__ == "__main__":
    main()
