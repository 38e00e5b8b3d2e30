"""Who is asked: a screen, or a test."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, TypeVar

Answer = TypeVar("Answer")


class Person(Protocol):
    """Who is asked; None where a question is left without an answer."""

    async def choice(
        self, question: str, answers: Sequence[tuple[Answer, str]], at: int = 0
    ) -> Answer | None:
        """One of these answers, each with its words; that ``at`` a place is proposed."""

    async def line(
        self, question: str, hint: str, without: str = "", default: str = ""
    ) -> str | None:
        """What is typed; ``without`` are words for what happens without it."""

    async def written(self, job: Callable[..., Answer]) -> Answer | None:
        """What a job gives that writes files, with ``replace`` or not; None where it does not."""

    def say(self, text: str) -> None:
        """What happened last; keys are ids in braces."""


async def asked_path(person: Person, question: str, default: Path | str = "") -> Path | None:
    """The file that is typed; None without an answer."""
    text = await person.line(question, "path", default=str(default))
    return Path(text).expanduser() if text else None
