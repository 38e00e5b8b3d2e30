"""The alias map in words."""

from __future__ import annotations

from app.report.text.planning import alias_text
from calib.diagnosis.results import AliasMap, EffectName, Imitation


def test_an_effect_that_imitates_in_several_sizes_is_named_once() -> None:
    squareness, cyclic, play = (
        EffectName("axis_squareness", "xy"),
        EffectName("actuator_cyclic", "z"),
        EffectName("backlash", "y"),
    )
    by = (cyclic, cyclic, play, cyclic)
    alias_map = AliasMap(
        effects=(squareness, cyclic, play),
        imitations=tuple(Imitation(squareness, imitator, 0.99, 4.0) for imitator in by),
        invisible=(),
    )
    text = " ".join(alias_text(alias_map).split())
    assert text.endswith("axis_squareness (xy): actuator_cyclic (z), backlash (y)")
    assert "3 effects and places; 1 of them" in text
