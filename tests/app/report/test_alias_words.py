"""The alias map in words."""

from __future__ import annotations

from app.report.text.planning import alias_text
from calib.diagnosis.results import AliasMap, Imitation, Named


def test_an_effect_that_imitates_in_several_sizes_is_named_once() -> None:
    squareness, cyclic, play = (
        Named("axis_squareness", "xy"),
        Named("actuator_cyclic", "z"),
        Named("backlash", "y"),
    )
    by = (cyclic, cyclic, play, cyclic)
    found = AliasMap(
        effects=(squareness, cyclic, play),
        imitations=tuple(Imitation(squareness, each, 0.99, 4.0) for each in by),
        invisible=(),
    )
    said = " ".join(alias_text(found).split())
    assert said.endswith("axis_squareness (xy): actuator_cyclic (z), backlash (y)")
    assert "3 effects and places; 1 of them" in said
