"""A person for conversations that need no terminal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

Answer = TypeVar("Answer")


class Scripted:
    """A person who gives these answers: the beginning of a row's words, or what is typed."""

    def __init__(self, *answers: str | None) -> None:
        self.answers, self.questions = list(answers), list[str]()
        self.offered, self.proposed = list[list[str]](), list[str]()
        self.lines = list[str]()

    async def choice(
        self, question: str, answers: Sequence[tuple[Answer, str]], at: int = 0
    ) -> Answer | None:
        self.questions.append(question)
        self.offered.append([words for _, words in answers])
        self.proposed.append(answers[at][1])
        beginning = self.answers.pop(0)
        if beginning is None:
            return None
        return next(answer for answer, words in answers if words.startswith(beginning))

    async def line(
        self, question: str, hint: str, without: str = "", default: str = ""
    ) -> str | None:
        self.questions.append(question)
        return self.answers.pop(0)

    async def written(self, job: Callable[..., Answer]) -> Answer | None:
        return job(replace=False)

    def say(self, text: str) -> None:
        self.lines.append(text)
