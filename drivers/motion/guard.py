"""A process beside the program that stops the machine when the program no longer runs.

A dropped connection ends no move of a controller, nor does a program that is killed, hung,
suspended or asleep. While the machine may move, the program sends a beat twenty times a second and
gets each one back. No beat for `SILENCE_S`: the guard stops the machine. No beat back for as long:
the program does.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import IO

from drivers.motion.controller import NOT_STOPPED, Controller, ControllerFault, Limits, MotionFault

SILENCE_S = 0.3
"""Without a beat for so long nobody watches the machine. With a stop after it, 0.5 s are kept."""

BEAT_S = 0.05
START_S = 10.0
"""For an interpreter to start on a busy computer."""

STOPPING_S = 20.0
"""For so long the guard goes on stopping a machine that is not seen to rest."""

LEAVING_S = 2.0
"""For so long a program that leaves waits for a guard that is stopping the machine."""

DETACHED: list[subprocess.Popen[bytes]] = []
"""Guards that go on without the program."""

BEAT, HOMING, REST, BYE = b"a", b"h", b"d", b"q"
READY, SILENT = b"!", b"-"

NOWHERE = Limits((0.0,) * 3, (0.0,) * 3, 0.0, 0.0)
"""The guard moves nothing."""

# Its own folder first: neither the current one nor what an empty PYTHONPATH means is searched.
PROGRAM = (
    "import sys; sys.path.insert(0, sys.argv.pop(1)); "
    "from drivers.motion import guard; guard.main()"
)


class Guard:
    """The guard's end in the program. Raises `ControllerFault` where it does not start."""

    def __init__(self, controller: Controller, silence_s: float = SILENCE_S) -> None:
        self._controller = controller
        self._silence_s = silence_s
        self._echo_s = -1.0
        self._news = threading.Event()
        self._ready = False
        ports = controller.handles() if os.name == "posix" else ()
        name = f"{controller.name}:{controller.address}"
        root = str(Path(__file__).parents[2])
        command = [sys.executable, "-P", "-c", PROGRAM, root, name, f"{silence_s:g}"]
        self.process = subprocess.Popen(
            [*command, *map(str, ports)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=ports,
            bufsize=0,
            start_new_session=True,  # a key that ends this program must not end it, too
        )
        assert self.process.stdout is not None
        self._listens = threading.Thread(
            target=self._listen, args=(self.process.stdout,), name="guard", daemon=True
        )
        self._listens.start()

    def wait(self) -> None:
        """Return when it watches. Raises `ControllerFault` where it does not start."""
        end_s = time.monotonic() + START_S
        while not self._ready:
            if self.process.poll() is not None or time.monotonic() > end_s:
                self.close()
                next_step = "Without it nothing moves."
                raise ControllerFault(
                    MotionFault.PROGRAM, "guard beside the program", "did not start", "", next_step
                )
            self._news.wait(BEAT_S)
            self._news.clear()

    def _listen(self, answers: IO[bytes]) -> None:
        with answers, contextlib.suppress(OSError, ValueError):
            while received := answers.read(64):
                if BEAT in received or HOMING in received:  # it is armed
                    self._echo_s = time.monotonic()
                self._ready = self._ready or READY in received
                self._news.set()

    @property
    def runs(self) -> bool:
        """Whether the process is there."""
        return self.process.poll() is None

    @property
    def watches(self) -> bool:
        """Whether its last beat came back in time."""
        return self.process.poll() is None and time.monotonic() - self._echo_s < self._silence_s

    def send(self, word: bytes) -> None:
        """A beat or a word; nothing where it is gone."""
        assert self.process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(word)

    def close(self, *, resting: bool = True) -> None:
        """Let it go; where the machine was not seen to rest it goes on stopping it."""
        if resting:
            self.send(BYE)
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):
            self.process.stdin.close()
        try:
            self.process.wait(START_S if resting else LEAVING_S)
        except subprocess.TimeoutExpired:
            if not resting:
                DETACHED.append(self.process)
                return
            self.process.kill()
            self.process.wait()
        self._listens.join()


def main() -> None:
    """Watch the beats on standard input; stop the machine when they end."""
    from drivers.motion import controller_of
    from drivers.motion.grbl import Grbl

    name, silence, *ports = sys.argv[1:]
    guarded = controller_of(name, NOWHERE)
    if ports and isinstance(guarded, Grbl):
        guarded.adopt(int(ports[0]))
    messages: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_hear, args=(messages,), daemon=True).start()
    os.write(1, READY)
    armed = False
    while True:
        try:
            word = messages.get(timeout=float(silence) if armed else None)
        except queue.Empty:
            word = SILENT
        if word == BYE or (not word and not armed):
            return
        if word in (BEAT, HOMING):
            armed, guarded.homing = True, word == HOMING
        elif word == REST:
            armed = False
        else:
            armed = False
            _stop(guarded, messages)
            if not ports:
                guarded.close()  # else it would keep control
            if not word:
                return


def _hear(messages: queue.SimpleQueue[bytes]) -> None:
    """Every byte in turn, each sent back; an empty one at the end of the program."""
    with contextlib.suppress(OSError):
        while received := os.read(0, 64):
            with contextlib.suppress(OSError):
                os.write(1, received)
            for number in received:
                messages.put(bytes((number,)))
    messages.put(b"")


def _stop(guarded: Controller, messages: queue.SimpleQueue[bytes]) -> None:
    """Stop the machine, until it is seen to rest, or the program runs again and does it itself."""
    end_s = time.monotonic() + STOPPING_S
    try:
        guarded.stop(lambda _: not messages.empty() or time.monotonic() > end_s)
    except ControllerFault as problem:
        if messages.empty():
            sys.stderr.write(f"glidecal no longer ran. {NOT_STOPPED} ({problem.found})\n")


if __name__ == "__main__":
    main()
