"""Lines of G-code: a command and its words, in configurations and as firmware repeats them."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from calib.errors import RecordError
from protocols.documents import MOST_BYTES, Triple, read_bytes

Texts = list[tuple[Path, str]]
"""Files in the order in which they were named, each with its text."""

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
NUMBER_END = r"(?![\w.,])"
"""Behind the last number of an answer: it is all there, as it is not in ``-0,12`` or ``1e308``."""
COMMAND = re.compile(r"([GM]\d+)(?![\d.:])\s*(.*)")
WORD = re.compile(rf"([A-Z])\s*({NUMBER}(?:\s*:\s*{NUMBER})*°?)?\s*")
"""A letter, numbers if it has some, and a degree sign if it is copied from an answer."""
WORDS = re.compile(rf"(?:{WORD.pattern})*")
IN_BRACKETS = re.compile(r"\([^()]*\)")
"""A comment within a line."""
PREFIX = re.compile(
    r"^(?:# |< )?(?:\d[\d:.,/ -]*(?: [AP]M)?(?: :| ->?|:) )?(?:Recv: |Read: |<<< |< )?"
    r"(?:echo:)?\s*",
    re.IGNORECASE,
)
"""What hosts and firmware write before a line: date and time, the sender, ``echo:``."""


def read_printed(path: Path, subject: str, most_bytes: int = MOST_BYTES) -> str:
    """The text of a file from a host or an editor, line breaks as ``\\n``.

    It is UTF-8, or UTF-16 with its mark, or else of a code page: what matters is ASCII in all of
    them, and any byte has a letter in latin-1. Raises as `read_bytes`.
    """
    content = read_bytes(path, subject, most_bytes)
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = content.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


@dataclass(frozen=True)
class CodeLine:
    """A command with its words, where it stands, and as it stands there."""

    path: Path
    number: int
    text: str
    command: str
    words: dict[str, tuple[float, ...]]

    @property
    def source(self) -> str:
        """File and line, for messages."""
        return f"{self.path.name}, line {self.number}"

    def value(self, letter: str, usual: float = 0.0) -> float:
        """The one number behind a letter; ``usual`` where the letter is missing.

        Raises RecordError where there are several, or none behind the letter.
        """
        numbers = self.words.get(letter)
        if numbers is None:
            return usual
        if len(numbers) != 1 or not math.isfinite(numbers[0]):
            raise self.fault(f"{letter} and a number")
        return numbers[0]

    def fault(self, requirement: str, next_step: str = "", *, meaning: str = "") -> RecordError:
        """The error that this line deserves, ``meaning`` added to its text."""
        return RecordError(
            f"file of a printer {self.source}", f"{self.text!r}{meaning}", requirement, next_step
        )


def commands(texts: Texts, *codes: str) -> Iterator[CodeLine]:
    """The lines of these commands in the order of the files; comments and all else are left.

    Letters may be small, and stand with or without spaces, as firmware takes them. Raises
    RecordError for such a command with anything but letters and numbers behind it.
    """
    for path, text in texts:
        for number, raw in enumerate(text.splitlines(), start=1):
            plain = PREFIX.sub("", IN_BRACKETS.sub("", raw.split(";", 1)[0])).strip()
            match = COMMAND.fullmatch(plain.upper())
            if match is None or match[1] not in codes:
                continue
            values = {
                letter: tuple(float(part) for part in numbers.strip("°").split(":") if part)
                for letter, numbers in WORD.findall(match[2])
            }
            line = CodeLine(path, number, plain, match[1], values)
            if not WORDS.fullmatch(match[2]):
                requirement = f"{match[1]} with letters and numbers"
                raise line.fault(requirement, "Write numbers in the place of expressions.")
            yield line


def motor_steps(texts: Texts) -> Triple | None:
    """Steps per mm of the motors of towers X, Y, Z: the last of M92; None without one for each.

    Raises RecordError for one that is no number above 0.
    """
    steps: dict[str, float] = {}
    for line in commands(texts, "M92"):
        for tower in set("XYZ") & line.words.keys():
            steps[tower] = line.value(tower)
            if not steps[tower] > 0.0:
                raise line.fault("steps per mm above 0")
    return (steps["X"], steps["Y"], steps["Z"]) if len(steps) == len("XYZ") else None


def lines(texts: Texts) -> Iterator[tuple[str, str]]:
    """Every line as ``file, line N`` and its text."""
    for path, text in texts:
        for number, raw in enumerate(text.splitlines(), start=1):
            yield f"{path.name}, line {number}", raw.strip()
