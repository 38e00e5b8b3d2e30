"""What can be wrong with a controller and its line, a class each; one to three of them by seed."""

from __future__ import annotations

import math
import random
import re
import time

from tests.drivers.motion.adversary import FULL, Front, Ill, Link
from tests.drivers.motion.twins import (
    FailingLinuxCnc,
    GrblTwin,
    MotionTrouble,
)

EITHER_S = 3.0
"""A late answer is late by so much at most."""

NUMBER = re.compile(rb"-?\d+\.\d+")
NO_NUMBERS = (b"nan", b"NaN", b"inf", b"0.0.0", b"-", b"", b"1-2", b"1e400", b"9" * 300, b"1_0.0")


class LiesNumbers(Ill):
    """A number of a position that is none, or another at random."""

    def choose(self) -> None:
        self.share = self.generator.choice((0.1, 0.5, 1.0))
        self.words = self.generator.choice((*((w,) for w in NO_NUMBERS), NO_NUMBERS, None))

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        if b"Pos" not in answer and b"_POS" not in answer:
            return answer
        if self.generator.random() > self.share:
            return answer
        case = self.generator.randrange(3)
        numbers = list(NUMBER.finditer(answer))
        if case >= len(numbers):
            return answer
        word = numbers[case]
        new = b"%.3f" % self.generator.uniform(-90.0, 90.0)
        new = self.generator.choice(self.words) if self.words else new
        return answer[: word.start()] + new + answer[word.end() :]


class LiesStill(Ill):
    """Always the place where it was when this began, at rest: consistent."""

    false_place = True

    def choose(self) -> None:
        self.numbers: list[bytes] = []

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        answer = answer.replace(b"RUNNING", b"IDLE").replace(b"<Jog", b"<Idle")
        if b"MPos" not in answer and b"ABS_ACT_POS" not in answer:
            return answer
        numbers = NUMBER.findall(answer)[:3]
        self.numbers = self.numbers or numbers
        for old, new in zip(numbers, self.numbers, strict=False):
            answer = answer.replace(old, new, 1)
        return answer


class LiesArrival(Ill):
    """Idle while it moves, or moving while it rests; the position is true."""

    def choose(self) -> None:
        self.idle = self.generator.random() < 0.6
        self.share = self.generator.choice((0.3, 1.0))

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        if self.generator.random() > self.share:
            return answer
        if self.idle:
            return answer.replace(b"RUNNING", b"IDLE").replace(b"<Jog", b"<Idle")
        return answer.replace(b"STATUS IDLE", b"STATUS RUNNING").replace(b"<Idle", b"<Jog")


class Late(Ill):
    """All answers, or one, come later."""

    def choose(self) -> None:
        self.late_s = self.generator.choice((0.05, 0.15, 0.35, 1.0, EITHER_S))
        self.single = self.generator.random() < 0.5

    def delay_s(self) -> float:
        late_s = self.late_s
        if self.single:
            self.late_s = 0.0
        return late_s


class Mute(Ill):
    """It hears and does what it is told, and answers nothing."""

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        return b""


class Deaf(Ill):
    """Nothing that is sent reaches it."""

    deaf = True

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        return b""


STRANGERS = (
    b"+0001.234\r\n",  # an indicator
    b"01A+00012.345\r",
    b"  1.2345 mm\r\n",
    b"T:21.30 /0.00 B:20.90 /0.00 @:0 B@:0\nok\n",  # a Marlin printer
    b"echo:busy: processing\n",
    b"start\necho:Marlin 2.1.2\n",
    b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>\r\n",  # FluidNC
    b"<Run|WPos:1.000,0.000,0.000|Bf:15,128|FS:500,0>\r\n",
    b"[MSG:INFO: Connecting to STA]\r\n",
    b"ok\r\n",
    b"ABS_ACT_POS 0.0 0.0 0.0 0.0 0.0 0.0\r\n",
    b"SET ABORT ACK\n\r",
    b"ERROR OK\r\n",
    b"\r\n",
    b"\n\r \n\r ",
    b"x" * 300,  # without an end
    b"\x00\xff\x8d\xfe",
)


class Chatters(Ill):
    """Lines that nobody asked for, now and then or without end."""

    chatty = True

    def choose(self) -> None:
        self.line = self.generator.choice((*STRANGERS, self.generator.randbytes(40)))
        self.every_s = self.generator.choice((0.0, 0.0, 0.002, 0.05, 0.3))
        self._next_s = 0.0

    @property
    def false_place(self) -> bool:  # type: ignore[override]
        """It is the report of a controller, of another machine."""
        return b"MPos:" in self.line or b"ABS_ACT_POS" in self.line

    def acts(self, front: Front) -> None:
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + self.every_s
        count = 1 if self.every_s else max(1, 4096 // len(self.line))
        for link in front.links:
            if sum(len(part) for _, part in link.outward) < FULL:
                link.outward.append((0.0, self.line * count))


NAMES = ("ABS_ACT_POS", "PROGRAM_STATUS", "ERROR", "ENABLE", "MODE", "SET", "ok", "MPos", "Idle")


class Garbles(Ill):
    """Bytes flipped, lost, doubled; lines cut, joined, ended otherwise; wrong names."""

    def choose(self) -> None:
        self.rate = self.generator.choice((0.001, 0.01, 0.1))
        kinds = ("bytes", "ends", "joins", "cuts", "names", "doubles")
        self.kinds = self.generator.sample(kinds, self.generator.randint(1, 3))
        self.both_ways = self.generator.random() < 0.2
        self.deaf = self.both_ways

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        return self._bytes(content) if self.both_ways else content

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        chance = self.generator.random
        if "bytes" in self.kinds:
            answer = self._bytes(answer)
        if "ends" in self.kinds:
            answer = answer.replace(
                b"\n", self.generator.choice((b"\n", b"\r", b"\n\r\n", b"\r\r\n"))
            )
        if chance() > 10.0 * self.rate:
            return answer
        if "joins" in self.kinds:
            answer = answer.replace(b"\r", b"").replace(b"\n", b"")
        if "cuts" in self.kinds:
            answer = answer[: self.generator.randrange(len(answer) + 1)]
        if "names" in self.kinds:
            first, second = self.generator.sample(NAMES, 2)
            answer = answer.replace(first.encode(), second.encode())
        if "doubles" in self.kinds:
            answer *= 2
        return answer

    def _bytes(self, text: bytes) -> bytes:
        garbled = bytearray()
        for byte in text:
            if self.generator.random() > self.rate:
                garbled.append(byte)
                continue
            match self.generator.randrange(3):
                case 0:
                    garbled.append(byte ^ 1 << self.generator.randrange(8))
                case 1:
                    garbled += bytes((byte, byte))
        return bytes(garbled)


class Drops(Ill):
    """It hangs up: at a count of bytes, as soon as somebody comes, or when it is told to stop."""

    deaf = True

    def choose(self) -> None:
        self.at = self.generator.choice(("count", "once", "stop"))
        self.count = self.generator.randrange(1, 3000)
        self._done = False

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        stop = b"abort" in content or b"\x85" in content
        if self.at == "stop" and stop and self.generator.random() < 0.7:
            front.drop(link)
            return b""
        return content

    def acts(self, front: Front) -> None:
        for link in list(front.links):
            over = self.at == "count" and link.sent > self.count
            if over or (self.at == "once" and not self._done):
                self._done = True
                front.drop(link)


class Refuses(Ill):
    """NAK or an error to what it is told, or no acknowledgement at all."""

    deaf = True

    def choose(self) -> None:
        self.what = self.generator.choice(("any", "stop", "move", "never"))
        self.number = self.generator.choice((1, 8, 9, 15, 22, 999))

    def hears(self, front: Front, link: Link, content: bytes) -> bytes:
        if self.what == "never":
            return content
        if front.name == "grbl":
            if self.what == "stop":
                return content.replace(b"\x85", b"")
            if b"\n" in content:
                front.answer(link, b"error:%d\r\n" % self.number)
                return b""
            return content
        lines_through = []
        for line in content.splitlines(keepends=True):
            words = line.split()
            prefix = {"any": b"", "stop": b"abort", "move": b"mdi"}[self.what]
            if words[:1] == [b"set"] and prefix in words[1] and not words[1].startswith(b"e"):
                front.answer(link, b"SET %s NAK\n\r" % words[1].upper())
            else:
                lines_through.append(line)
        return b"".join(lines_through)

    def tells(self, front: Front, link: Link, answer: bytes) -> bytes:
        if self.what != "never":
            return answer
        return re.sub(rb"ok\r\n|SET \w+ ACK\n\r", b"", answer)


BY_OTHERS = (
    MotionTrouble.NOT_HOMED,
    MotionTrouble.ESTOP,
    MotionTrouble.FOLLOWING,
    MotionTrouble.OFF,
    MotionTrouble.NAK,
    MotionTrouble.MODE,
    MotionTrouble.UNHOMED,
    MotionTrouble.OVERRIDE,
    MotionTrouble.OVERRIDE,
    MotionTrouble.OFFSET,
    MotionTrouble.OFFSET,
    MotionTrouble.FEED_HOLD,
    MotionTrouble.ELSEWHERE,
)


class Changes(Ill):
    """Somebody at the panel, or another client, changes something once."""

    def choose(self) -> None:
        self.trouble = self.generator.choice(BY_OTHERS)
        self._done = False
        # off, it does not move; and it refuses an abort then
        self.deaf = self.trouble in (MotionTrouble.OFF, MotionTrouble.NAK)

    def acts(self, front: Front) -> None:
        if not self._done:
            self._done = True
            front.changed(f"{self.trouble}", lambda: front.twin.befall(self.trouble))


class Inches(Ill):
    """Another client leaves inches in force."""

    def choose(self) -> None:
        self._done = False

    def acts(self, front: Front) -> None:
        if not self._done and isinstance(front.twin, FailingLinuxCnc):
            self._done = True
            front.twin.modal({"G20"})


class Jogs(Ill):
    """It moves by itself, or by somebody else: far or a little, fast or slowly."""

    def choose(self) -> None:
        self.way_mm = self.generator.choice((0.05, 0.5, 5.0, 20.0))
        self.feed = self.generator.choice((60.0, 600.0, 6000.0))
        self.axis = self.generator.randrange(3)
        self._done = False

    def acts(self, front: Front) -> None:
        if not self._done:
            self._done = True
            x, y, z = front.axes.at_mm
            there = (x + self.way_mm * (self.axis == 0), y + self.way_mm * (self.axis == 1), z)
            there = (there[0], there[1], z + self.way_mm * (self.axis == 2))
            front.changed("jog", lambda: front.axes.jog(there, self.feed))


class Restarts(Ill):
    """It starts anew in the middle, and may be locked after it."""

    def choose(self) -> None:
        self.locked = self.generator.random() < 0.7
        self._done = False

    def acts(self, front: Front) -> None:
        if self._done:
            return
        self._done = True
        if isinstance(front.twin, GrblTwin):
            front.axes.stop()
            front.twin.received = b""
            if self.locked:
                front.changed("restart", lambda: front.twin.befall(MotionTrouble.NOT_HOMED))
            for link in front.links:
                front.answer(link, b"\r\nGrbl 1.1h ['$' for help]\r\n")
            return
        front.axes.stop()
        for link in list(front.links):
            front.drop(link)


ILLS: tuple[type[Ill], ...] = (
    LiesNumbers,
    LiesStill,
    LiesArrival,
    Late,
    Late,
    Mute,
    Deaf,
    Chatters,
    Chatters,
    Garbles,
    Garbles,
    Drops,
    Refuses,
    Changes,
    Changes,
    Changes,
    Jogs,
    Jogs,
    Inches,
    Restarts,
)
SPAN_S = 1.2
"""Ills begin within so long after the start: the scenario is about as long."""


def ills_of(seed: int) -> list[Ill]:
    """One to three ills, each from a moment of its own; some from the start."""
    generator = random.Random(seed)
    ills = []
    for _ in range(generator.choice((1, 1, 2, 3))):
        kind = generator.choice(ILLS)
        begins_s = 0.0 if generator.random() < 0.1 else generator.uniform(0.05, SPAN_S)
        lasts_s = generator.choice((0.1, 0.5, 2.0, math.inf, math.inf))
        ills.append(kind(random.Random(generator.random()), begins_s, lasts_s))
    return ills
