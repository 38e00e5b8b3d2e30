"""Which effects a procedure cannot tell apart, without any reading."""

from __future__ import annotations

from calib.diagnosis.aliases import alias_map
from calib.tripod.effects import CATALOGUE
from calib.tripod.pipeline import Model
from tests.calib.diagnosis.diagnosed_sessions import SHORT, TWO_STATION


def test_aliases_need_no_data() -> None:
    short, long = (
        alias_map(Model(parameters_mm=(1.0, -0.8, 0.6, 0.03, -0.02, 0.01)), observations, CATALOGUE)
        for observations in (SHORT, TWO_STATION)
    )
    assert len(short.imitations) > len(long.imitations)
    assert any(alias.left_in_noise_variances < 9.0 for alias in short.imitations)
    for alias in (*short.imitations, *long.imitations):
        assert alias.effect.id != alias.by.id
        assert 0.98 < alias.contained <= 1.0 + 1e-9
    assert {(alias.by, alias.effect) for alias in short.imitations if alias.contained > 0.9999} & {
        (alias.effect, alias.by) for alias in short.imitations
    }
