"""What a choice at home leads to: which sessions are asked for and which are proposed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from app.dialogue.person import Person, asked_path
from app.measuring.recorded import SessionFile, follow_up, look_at
from app.report.text import home as texts
from calib.errors import RecordError, UsageError

if TYPE_CHECKING:  # it loads the solver
    from app.measuring.plan import Plan

Errand = tuple[str, Path, Path | None]
"""What is done, with which session, and the one after it where two are compared."""


@dataclass(frozen=True)
class SessionChoice:
    """A person chooses among the ``recent`` sessions, or one in another place."""

    person: Person
    recent: Sequence[SessionFile]
    read_only: bool = False

    async def errand(self, verb: str, path: str) -> Errand | None:
        """The errand with the session of this path, or after asking which one; None: the question
        is left.

        Raises RecordError for a session that cannot be read, UsageError where it has no comparison.
        """
        session = next((entry for entry in self.recent if str(entry.path) == path), None)
        if session is None:
            session = await self._one(texts.WHICH["before" if verb == "compare" else verb])
        elif session.problem:
            raise RecordError(session.problem)
        if session is not None and verb == "session":
            choices = texts.session_choices(session, read_only=self.read_only)
            verb = await self.person.choice(texts.session_label(session), choices) or ""
        if session is None or not verb:
            return None
        return await self._pair(session) if verb == "compare" else (verb, session.path, None)

    async def _pair(self, session: SessionFile) -> Errand | None:
        """The errand with the session after it; one that verifies another brings its partner."""
        from app.evaluating.comparison import partner_of  # it loads the solver

        if session.own_form:
            raise UsageError(texts.NO_COMPARISON)
        if partner := partner_of(session.path, session.verifies):
            question = texts.partner_question(session.path, partner)
            answer = await self.person.choice(question, texts.PARTNER_CHOICES)
            if answer != "other":
                return ("compare", partner, session.path) if answer else None
        later = await self._one(f"{session.path}\n{texts.WHICH['after']}", session)
        return ("compare", session.path, later.path) if later else None

    async def _one(
        self, question: str, partner_file: SessionFile | None = None
    ) -> SessionFile | None:
        """A session that can be read; after a ``partner_file`` its verification is proposed."""
        listed = [session for session in self.recent if session != partner_file]
        rows: list[tuple[SessionFile | None, str]] = [(s, texts.session_label(s)) for s in listed]
        partner = follow_up(partner_file, listed) if partner_file else None
        at = listed.index(partner) if partner else 0
        prompt = question if listed else f"{question}\n{texts.NO_SESSIONS}"
        elsewhere = SessionFile(Path(), texts.ELSEWHERE)
        rows.append((elsewhere, texts.ELSEWHERE))
        while session := await self.person.choice(prompt, rows, at):
            if session is elsewhere:
                path = await asked_path(self.person, texts.WHICH_PATH)
                if path is None:
                    continue
                session = look_at(path)
            if not session.problem:
                return session
            prompt = f"{session.problem}\n\n{question}"
        return None


async def plan_to_go_on(person: Person, path: Path) -> Plan | None:
    """The plan of an interrupted session, after asking for the ports on another computer.

    Raises RecordError, UsageError, IndicatorError; None where the question is left.
    """
    from app.measuring.indicators import parse_indicator
    from app.measuring.plan import PortsUnknown, plan_to_continue

    typed: str | None = ""
    while typed is not None:
        try:
            return plan_to_continue(path, tuple(map(parse_indicator, typed.split())))
        except PortsUnknown as problem:
            question = texts.PORTS_QUESTION.format(problem.thing)
            typed = await person.line(question, texts.PORTS_HINT) or None
    return None
