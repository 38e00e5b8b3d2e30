"""Files of one blind run: sessions, sealed truths, append-only results; a run can be resumed."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tests.blind.generator import Made

Json = dict[str, Any]


class Folder:
    """Where one run keeps its files."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sessions = path / "sessions"
        self.sessions.mkdir(parents=True, exist_ok=True)
        self.truths = path / "truths.jsonl"
        self.sealed = path / "truths.json"
        self.results = path / "results.jsonl"
        self.baselines = path / "baselines.jsonl"

    def results_of(self, answerer: str) -> Path:
        """Results of another answerer than today's program."""
        return self.results if answerer == "today" else self.path / f"results-{answerer}.jsonl"

    def session(self, name: str) -> Path:
        return self.sessions / f"{name}.jsonl"


def write_session(session: Made, path: Path, machine: Path | None = None) -> None:
    """The session as ``glidecal import`` makes it from the table; the truth stays out of it.

    ``machine`` is the machine file, where it is not the prototype's as it stands.
    """
    from app.commands.sessions import import_files

    path.unlink(missing_ok=True)
    table = path.with_suffix(".csv")
    table.write_text(session.table, encoding="utf-8")
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            import_files(
                [table],
                path,
                machine=str(machine) if machine else None,
                resolution=session.resolution_mm,
            )
    finally:
        table.unlink()


def append(path: Path, document: Json) -> None:
    """One line; a line torn by a kill is skipped by ``lines``."""
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(document, ensure_ascii=False) + "\n")


def lines(path: Path) -> list[Json]:
    """Every whole line."""
    documents = []
    if path.exists():
        for line in path.read_text(encoding="utf-8").splitlines():
            with contextlib.suppress(json.JSONDecodeError):
                documents.append(json.loads(line))
    return documents


def seal(folder: Folder, session_names: Iterable[str]) -> tuple[dict[str, Json], str]:
    """Truths of these sessions in one sorted file, and its SHA-256."""
    names = set(session_names)
    with_truth = [line for line in lines(folder.truths) if "truth" in line]
    truths = {line["session"]: line["truth"] for line in with_truth if line["session"] in names}
    text = json.dumps(truths, sort_keys=True, ensure_ascii=False, indent=0)
    folder.sealed.write_text(text, encoding="utf-8")
    return truths, hashlib.sha256(text.encode()).hexdigest()


def sealed_truths(folder: Folder) -> tuple[dict[str, Json], str]:
    """What was sealed; only scoring calls this."""
    text = folder.sealed.read_text(encoding="utf-8")
    truths: dict[str, Json] = json.loads(text)
    return truths, hashlib.sha256(text.encode()).hexdigest()
