"""The published experiments: every figure of the papers' tables that can be computed.

Data: Pashkevich, Chablat, Wenger, Gomolitsky 2008, tables 1 and 2, as in sample_sessions/tables.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib.arrays import Observations
from calib.errors import NotIdentifiable
from calib.identify.solution import Solution, Subset
from calib.noise.reading import IndicatorFigures
from calib.tripod.differences import differences, reading_matrix
from calib.tripod.geometry import Geometry
from calib.tripod.pipeline import Model
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold
from tests.calib.identify.identified import identify

MODEL = Model()
STATED = IndicatorFigures(resolution_mm=0.01, repeatability_mm=0.02)


def published(samples: Path, name: str) -> Observations:
    return to_observations([fold(read_record(samples / f"{name}.jsonl").events)])


def solved(samples: Path, name: str, subset: Subset) -> Solution:
    return identify(MODEL, published(samples, name), subset, "linear", indicator=STATED)


@pytest.mark.parametrize(
    ("name", "subset", "values", "before", "after"),
    [
        ("experiment_2_twelve", "joint-offsets", [-0.4856, 0.4990, -1.6712], 0.3230, 0.1379),
        ("experiment_2_twelve", "leg-lengths", [0.4937, -0.5244, 1.6850], 0.3230, 0.1350),
        (
            "experiment_2_twelve",
            "both",
            [4.3523, -5.5047, 1.3068, 4.8823, -6.0764, 3.0023],
            0.3230,
            0.1262,
        ),
        ("experiment_3_twelve", "joint-offsets", [0.2598, -0.0468, -0.3182], 0.1508, 0.1389),
        (
            "experiment_3_twelve",
            "both",
            [1.9786, -0.9990, -1.0614, 1.7372, -0.9625, -0.7514],
            0.1508,
            0.1382,
        ),
    ],
)
def test_twelve_differences(
    samples: Path, name: str, subset: Subset, values: list[float], before: float, after: float
) -> None:
    solution = solved(samples, name, subset)
    assert solution.values_mm == pytest.approx(values, abs=0.0005)
    assert solution.rms_before_mm == pytest.approx(before, abs=0.0005)
    assert solution.rms_after_mm == pytest.approx(after, abs=0.0005)


@pytest.mark.parametrize(
    ("number", "before", "after"), [(1, 1.209, 0.760), (2, 0.622, 0.195), (3, 0.213, 0.205)]
)
def test_six_differences(samples: Path, number: int, before: float, after: float) -> None:
    solution = solved(samples, f"experiment_{number}_six", "joint-offsets")
    assert solution.rms_before_mm == pytest.approx(before, abs=0.0005)
    assert solution.rms_after_mm == pytest.approx(after, abs=0.0005)


def test_residuals_of_experiment_2_six_as_printed(samples: Path) -> None:
    """Table 1 prints x_y -0.28, x_z 0.25, y_x 0.21, y_z -0.14, z_x -0.13, z_y 0.09."""
    solution = solved(samples, "experiment_2_six", "joint-offsets")
    residual = solution.differences.value_mm - solution.predicted_mm
    residuals = dict(zip(solution.differences.names, residual, strict=True))
    printed = {"x_y": -0.28, "x_z": 0.245, "y_x": 0.21, "y_z": -0.14, "z_x": -0.13, "z_y": 0.09}
    assert residuals == pytest.approx(printed, abs=0.0055)


def test_singular_values(samples: Path) -> None:
    """Theory section 2: twelve differences; section 3: six, of which three directions are seen."""
    for name, expected in [
        ("experiment_2_twelve", [1.0122, 0.6827, 0.6827, 0.0166, 0.0164, 0.0164]),
        ("experiment_2_six", [1.43, 0.90, 0.90, 0.0013, 0.0013, 0.0]),
    ]:
        observations = published(samples, name)
        system = differences(Geometry(), observations).combine @ reading_matrix(
            Geometry(), observations
        )
        singular = np.linalg.svd(system, compute_uv=False)
        assert singular == pytest.approx(expected, abs=0.006 if "six" in name else 5e-5)


def test_six_differences_do_not_give_six_parameters(samples: Path) -> None:
    with pytest.raises(NotIdentifiable, match="3 of 6 combinations not identifiable"):
        solved(samples, "experiment_1_six", "both")


def test_condition_number_and_weak_directions(samples: Path) -> None:
    solution = solved(samples, "experiment_2_twelve", "both")
    assert solution.condition_number == pytest.approx(61.9, abs=0.05)
    assert [d.combination for d in solution.weak_directions] == [
        "d_rho_x + d_L_x",
        "d_rho_y + d_L_y",
        "d_rho_z + d_L_z",
    ]


@pytest.mark.parametrize(
    ("subset", "expected", "last_digit"), [("both", 0.727, 1e-3), ("joint-offsets", 0.0207, 1e-4)]
)
def test_accuracy_of_equations_12_and_14(
    subset: Subset, expected: float, last_digit: float
) -> None:
    """Erratum: the papers say about 0.07 for sigma = 0.01; (12) with (14) gives 0.73."""
    from tests.builders import observed, postures

    solution = identify(
        MODEL,
        observed([0.0] * 6, postures()),
        subset,
        "linear",
        indicator=IndicatorFigures(repeatability_mm=0.01),
    )
    assert np.sqrt(np.diag(solution.covariance_mm2))[0] == pytest.approx(
        expected, abs=last_digit / 2
    )


def test_both_sets_of_three_do_alike_and_the_full_one_little_better(samples: Path) -> None:
    """As the authors found for experiment 2, who therefore corrected joint offsets alone."""
    offsets, lengths, all_mm = (
        solved(samples, "experiment_2_twelve", subset).rms_after_mm
        for subset in ("joint-offsets", "leg-lengths", "both")
    )
    assert lengths == pytest.approx(offsets, rel=0.03)
    assert 0.9 * offsets < all_mm < offsets


def test_what_is_left_is_ten_times_the_noise(samples: Path) -> None:
    fit = solved(samples, "experiment_2_twelve", "joint-offsets").lack_of_fit
    assert fit is not None
    assert fit.p_value < 1e-6
    assert np.sqrt(fit.statistic) == pytest.approx(11.0, abs=0.5)
