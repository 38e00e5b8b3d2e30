"""What the house promises of its structure, measured from the imports."""

from __future__ import annotations

import re
from collections import defaultdict

from benchmarks.structure import ROOMS, ROOT, structure

OF_EACH_MACHINE = {"Geometry", "Lines", "Procedure"}


def test_rooms_are_rooms() -> None:
    graph = structure()
    assert len(graph.largest_cycle) <= 3
    assert graph.numpy_in_app == ()
    assert graph.flat_in_app == ()


def test_one_name_one_meaning() -> None:
    """A class name stands once, but where each machine has its own of the same thing."""
    places: dict[str, list[str]] = defaultdict(list)
    for path in (path for room in ROOMS for path in (ROOT / room).rglob("*.py")):
        module = path.relative_to(ROOT).as_posix()
        for name in re.findall(r"^class (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE):
            places[name].append(module)
    twice = {name: modules for name, modules in places.items() if len(modules) > 1}
    assert {name for name in twice if not name.endswith("Options")} == OF_EACH_MACHINE
    assert all(any("hexaslide" in module for module in modules) for modules in twice.values())
