"""The gap in cells before and after adopting: figures, chart and map."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_files
from app.report.charts.results import residuals_before_and_after
from app.report.text.diagnosis import where_text
from calib.diagnosis.diagnose import explained_share
from tests.hidden_sessions import bowed_session


def test_residuals_against_the_readings_themselves(tmp_path: Path) -> None:
    """Adopted, each cell is within five of its standard deviations; before, many are not."""
    residuals = diagnose_files([bowed_session(tmp_path)]).diagnosis.residuals
    cells = residuals.cells
    assert max(abs(cell.strength) for cell in cells) > 10.0
    for cell in cells:
        assert cell.after_mm is not None
        assert abs(cell.after_mm) < 5.0 * cell.noise_mm
    before_mm = np.sqrt(np.mean(np.square([c.before_mm for c in cells])))
    assert residuals.before_rms_mm == pytest.approx(before_mm)
    assert residuals.after_rms_mm is not None
    assert residuals.after_rms_mm < 1.5 * residuals.noise_rms_mm < residuals.before_rms_mm / 3
    chart = residuals_before_and_after(cells)
    by_name = {series.name: series for series in chart.series}
    assert list(by_name) == ["noise", "before", "after adopting"]
    assert max(map(abs, by_name["before"].y)) == max(abs(1000.0 * c.before_mm) for c in cells)
    assert {round(x) for x in by_name["before"].x} == set(range(1, len(chart.x_names) + 1))


def test_the_map_marks_what_is_more_than_noise(tmp_path: Path) -> None:
    results = diagnose_files([bowed_session(tmp_path)])
    cells = results.diagnosis.residuals.cells
    text = where_text(results)
    strong = [cell for cell in cells if abs(cell.strength) > 5.0]
    table = text.split("▲ ▼ more")[0]
    assert strong
    assert len(re.findall("▲▲|▼▼", table)) == len(strong)
    assert len(re.findall(r"[+-]\d+\.\d", table)) == len(cells)


def test_explained_share() -> None:
    assert explained_share(2.0, 1.0) == 0.75
    assert explained_share(1.0, 2.0) == 0.0
    assert explained_share(0.0, 0.0) == 0.0
