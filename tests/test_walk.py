"""CONTRIBUTING's walk of a reading from the wire to the controller's file is the way it goes."""

from __future__ import annotations

import importlib
import re
import sys
import threading
from collections.abc import Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType, FrameType
from typing import get_type_hints

from tests.app.cli import run_here
from tests.conftest import ROOT

ROW = re.compile(r"^\| `([\w.]+)` \| (?:`([\w.]+)`|–) \|", re.MULTILINE)


def test_the_walk_of_a_reading(tmp_path: Path) -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = text.split("## One reading, from the wire to the controller")[1].split("\n## ")[0]
    rows = ROW.findall(section)
    assert len(rows) <= 15
    assert len({form for _, form in rows if form}) <= 12
    codes = [code_of(function) for function, _ in rows]
    session, folder = str(tmp_path / "s.jsonl"), str(tmp_path / "files")
    with entered(codes) as order:
        measured = run_here("run", "--simulated", "--headless", "-o", session)
        entries = ("--format", "linuxcnc", "--home-offset", "0,0,0")
        exported = run_here("export", session, *entries, "-o", folder)
    assert (measured[0], exported[0]) == (0, 0)
    remaining = iter(order)
    assert [row for row, code in zip(rows, codes, strict=True) if code not in remaining] == []
    for function, form in rows:
        hints = get_type_hints(attribute(function))
        assert not form or form in str(hints["return"]), (function, hints["return"])


def attribute(path: str) -> object:
    module = path
    names: list[str] = []
    while True:
        try:
            value: object = importlib.import_module(module)
            break
        except ModuleNotFoundError:
            module, _, name = module.rpartition(".")
            names.insert(0, name)
    for name in names:
        value = getattr(value, name)
    return value


def code_of(path: str) -> CodeType:
    function = attribute(path)
    code = getattr(getattr(function, "__func__", function), "__code__", None)
    assert isinstance(code, CodeType)
    return code


@contextmanager
def entered(codes: Container[CodeType]) -> Iterator[list[CodeType]]:
    """Those of the codes that are entered, as often as they are, in every thread."""
    order: list[CodeType] = []

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code in codes:
            order.append(frame.f_code)

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield order
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
