"""What the house promises of its structure, measured from the imports."""

from __future__ import annotations

from benchmarks.structure import structure


def test_rooms_are_rooms() -> None:
    found = structure()
    assert len(found.largest_cycle) <= 3
    assert found.numpy_in_app == ()
    assert found.flat_in_app == ()
