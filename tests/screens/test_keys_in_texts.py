"""Every key that a text of a screen names comes from the bindings, re-mapped ones too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from app.report.text.help import help_of
from app.report.text.tables import KEY_ID, keyed
from app.screens.diagnose import DiagnoseScreen
from app.screens.interface import Glidecal, HelpDialog
from app.screens.keys import known_keys, usual_key
from app.settings import Settings
from tests.conftest import ROOT, SAMPLES
from tests.screens.driving import SIZE, text, until

ROOMS = ("app/screens", "app/report/text", "app/measuring")
NAMED = r"(Escape|Enter|Space|Tab|Delete|Backspace|Page [Uu]p|Page [Dd]own|F[1-9]\d?|Ctrl[-+]\w)"
ACTS = r"(?<![\w°.])[A-HJL-TV-Y](?= [a-z]+s\b)"
PRESSED = r"\b([Pp]ress|[Kk]ey|then|until|,) [A-HJ-Z](?=[ .,;]|$)"
KEY = re.compile(rf"(?<![\w{{.-]){NAMED}(?![\w-])|{ACTS}|{PRESSED}")
"""A key by its name, or one letter that does something: "E writes", "press E", "then X."."""

NOT_TO_BE_CHANGED = {
    "Arrow keys and Enter": "of every list, Textual's own",
    "Enter accepts, {dialog.cancel} cancels.": "of every line to type into, Textual's own",
    "Up and down, Page up and Page down scroll": "of every text that scrolls, Textual's own",
    "Tab leads to the next field": "of every form, Textual's own",
    "palette, Ctrl+P, has": "Textual's own",
    "Here Enter moves": "a rehearsal in a plain terminal",
    "and Enter to that step; ": "the same",
    "H + M666 of RepRapFirmware, H − M666": "parameters of firmware",
    "p1 and p2 push a spindle in. Ctrl-C ends.": "a rehearsal in a plain terminal",
    "Ctrl-C ends it": "the server, in a plain terminal",
    "Enter the offset": "the verb",
    "Spindle, ": "no key",
}


def literals(path: Path) -> Iterator[tuple[int, str]]:
    """Texts of a file but docstrings, and what is no text: bindings, names of keys and actions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            skipped.add(node.value)
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("Binding", "compile"):
            skipped.update(ast.walk(node))
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in skipped:
            yield node.lineno, node.value


@cache
def texts_of(room: str) -> dict[str, list[tuple[int, str]]]:
    """Where they stand, by file; read where a test asks, for each process collects all tests."""
    texts = {path.name: list(literals(path)) for path in sorted((ROOT / room).glob("*.py"))}
    for path in (ROOT / room).glob("*.toml"):
        texts[path.name] = list(enumerate(path.read_text(encoding="utf-8").splitlines(), start=1))
    return texts


@pytest.mark.parametrize("room", ROOMS)
def test_no_key_is_written_by_hand(room: str) -> None:
    problems = []
    for name, texts in texts_of(room).items():
        for line, words in texts:
            for phrase in NOT_TO_BE_CHANGED:
                words = words.replace(phrase, "")
            problems += [f"{name}:{line} {hit[0]!r} in {words!r}" for hit in KEY.finditer(words)]
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("words", ["E writes it.", "Press G once.", "then X.", "Escape stops."])
def test_what_is_written_by_hand_is_seen(words: str) -> None:
    assert KEY.search(words)


def test_every_id_in_a_text_is_one_of_a_binding() -> None:
    valid_ids = set(known_keys())
    for texts in map(texts_of, ROOMS):
        ids = {
            hit
            for entries in texts.values()
            for _, words in entries
            for hit in KEY_ID.findall(words)
        }
        assert ids <= valid_ids


def test_help_rows_stand_in_columns() -> None:
    text = keyed("{a.b}  first\n{c.d}, {e.f}  second\nnot a row", {"a.b": "F1"}.get)
    assert text.splitlines() == ["F1            first", "{c.d}, {e.f}  second", "not a row"]


@pytest.mark.parametrize(
    "screen", ["result", "diagnose", "what-if", "hexaslide", "history", "measure", "prepare"]
)
def test_every_row_of_help_has_its_key(screen: str) -> None:
    known_keys()  # loads every screen
    page = keyed(help_of(screen), usual_key)
    assert not KEY_ID.search(page)
    assert all(len(line) <= 76 for line in page.splitlines())


def test_a_letter_writes_the_report_everywhere_or_nowhere() -> None:
    """R is the report of every result; nowhere does it lead to a result."""
    letters = {keys for key_id, keys, _ in known_keys().values() if key_id.endswith(".report")}
    assert letters == {("r",)}
    results = [keys for key_id, keys, _ in known_keys().values() if key_id.endswith(".result")]
    assert len(results) == 2
    assert all("r" not in keys for keys in results)


async def test_texts_follow_the_settings() -> None:
    """On the page, in its help, and on a dialog."""
    keys = {"diagnose.adopt": "f6", "diagnose.next": "f7", "help.close": "f8", "page.copy": "f9"}
    session = SAMPLES / "simulated_zero-max-min.jsonl"
    interface = Glidecal(DiagnoseScreen([session]), settings=Settings(keys=keys))
    async with interface.run_test(size=SIZE) as pilot:
        await until(pilot, "verdict", lambda: "Next: " in text(interface, "#verdict-text"))
        assert "F7 writes it." in " ".join(text(interface, "#verdict-text").split())
        await pilot.press("f1")
        await until(pilot, "help", lambda: isinstance(interface.screen, HelpDialog))
        words = text(interface, "Static")
        assert re.search(r"^F6 +adopt what was named", words, re.MULTILINE)
        assert re.search(r"^F9 +copy the page", words, re.MULTILINE)
        assert "F8 closes." in words
