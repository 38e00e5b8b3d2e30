"""Other postures of a Hexa Slide: what is asked of procedure, machine and number."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from app.dialogue.person import Person
from app.planning.hexaslide import Request, measuring
from app.report.text import hexaslide as texts
from calib.errors import UsageError
from calib.hexaslide.procedures import ProcedureKind

MOST_POSTURES = 200


async def asked_request(person: Person, subject: str, request: Request) -> Request | None:
    """Another procedure, other components or another machine file; None where it stays as it is.

    An empty line in place of a machine file is the example H60.
    """
    if subject == "procedure":
        kinds = [(kind, f"{kind}: {texts.PROCEDURE_WORDS[kind]}") for kind in ProcedureKind]
        kind = await person.choice(texts.WHICH_PROCEDURE, kinds)
        return replace(request, procedure=kind, measured=(), known=None) if kind else None
    if subject == "measured":
        components = ",".join(request.measured or ("x", "y", "z", "theta"))
        text = await person.line(texts.WHICH_COMPONENTS, "x,y,z,theta", default=components)
        return measuring(request, text) if text else None
    now = str(request.machine_file or "")
    text = await person.line(texts.WHICH_MACHINE, "path", default=now)
    if text in (None, now):
        return None
    return replace(request, machine_file=Path(text).expanduser() if text else None)


async def asked_count(person: Person, fewest: int, now: int) -> int | None:
    """How many postures; None without an answer. Raises UsageError."""
    question = f"How many postures? {fewest} or more."
    text = await person.line(question, "number", default=str(now))
    if not text:
        return None
    if not text.isdecimal() or not fewest <= int(text) <= MOST_POSTURES:
        raise UsageError("number of postures", f"'{text}'", f"{fewest} to {MOST_POSTURES}")
    return int(text)
