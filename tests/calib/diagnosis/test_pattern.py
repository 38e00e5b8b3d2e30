"""Whether several sessions leave one pattern: published data, simulated errors, chance."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from app.evaluating.diagnosis import diagnose_files
from calib.arrays import FloatArray, observe
from calib.diagnosis.pattern import shared_pattern
from calib.diagnosis.results import SharedPattern
from calib.posterior.cells import Cells, SessionCase
from calib.tripod.effects import CATALOGUE
from tests.calib.diagnosis.diagnosed_sessions import SWEEP, case, diagnose, with_readings
from tests.conftest import LONG, first_quick

SAMPLES = Path("sample_sessions")
TABLE_1 = {  # papers/000 table 1, Max - Min: x_y, y_x, y_z, z_y, x_z, z_x
    "1": (0.52, 2.37, -0.25, -0.04, 1.58, -0.57),
    "2": (-0.43, 0.42, -0.18, -0.70, -0.37, -1.14),
    "3": (-0.23, 0.34, -0.10, 0.11, 0.27, -0.09),
}
OF_PAIRS = ((0, 1), (1, 2), (0, 2))


def left_of_table_1(values: tuple[float, ...]) -> FloatArray:
    """Less what joint offsets do, by system (11): a = sin α, b = (0.5 + sin α) tan α."""
    sines = 60.0 / 310.25, -100.0 / 310.25
    a, b = (s for s in sines), ((0.5 + s) * math.tan(math.asin(s)) for s in sines)
    (a_max, a_min), (b_max, b_min) = tuple(a), tuple(b)
    matrix = np.zeros((6, 3))
    for row, (i, j) in enumerate(OF_PAIRS):
        matrix[2 * row, [i, j]] = a_max - a_min, b_max - b_min
        matrix[2 * row + 1, [i, j]] = b_max - b_min, a_max - a_min
    readings = np.array(values)
    return np.asarray(readings - matrix @ np.linalg.lstsq(matrix, readings, rcond=None)[0])


def published(*numbers: str, held_out: str = "") -> SharedPattern:
    paths = [SAMPLES / f"experiment_{n}_six.jsonl" for n in numbers]
    reference = [SAMPLES / f"experiment_{held_out}_six.jsonl"] if held_out else []
    pattern = diagnose_files(paths, held_out=reference).diagnosis.pattern
    assert pattern is not None
    return pattern


@pytest.mark.parametrize(
    ("first", "second"), first_quick([("1", "2"), ("1", "3"), ("2", "3")], several=True)
)
def test_cosines_of_table_1_by_the_matrix_of_the_papers(first: str, second: str) -> None:
    """The exact model and bars of their tolerance change them by a hundredth at most."""
    (pair,) = published(first, held_out=second).pairs
    a, b = (left_of_table_1(TABLE_1[n]) for n in (first, second))
    assert pair.cosine == pytest.approx(a @ b / np.sqrt(a @ a * (b @ b)), abs=0.01)
    assert pair.scale == pytest.approx(a @ b / (a @ a), rel=0.05)


@LONG
def test_what_is_left_in_experiments_2_and_3_is_one_pattern() -> None:
    """Of three directions a cosine c or more comes by chance with 1 - c."""
    pattern = published("2", held_out="3")
    assert pattern.reproducible
    assert pattern.directions == 3
    assert pattern.p_value_directions == pytest.approx(1.0 - pattern.pairs[0].cosine, rel=1e-6)
    assert pattern.pairs[0].after_rms_mm < 0.15 * pattern.pairs[0].before_rms_mm
    sentence = diagnose_files(
        [SAMPLES / "experiment_2_six.jsonl"], held_out=[SAMPLES / "experiment_3_six.jsonl"]
    ).diagnosis.sentence
    assert (
        "sessions 1 and 2 have the same residual pattern, by chance once in 159 times" in sentence
    )


@LONG
def test_the_twelve_differences_of_table_2_share_none() -> None:
    paths = [SAMPLES / f"experiment_{n}_twelve.jsonl" for n in "23"]
    diagnosis = diagnose_files(paths).diagnosis
    assert diagnosis.pattern is not None
    assert not diagnosis.pattern.reproducible
    assert diagnosis.pattern.pairs[0].cosine == pytest.approx(0.45, abs=0.01)
    assert "reproducible" not in diagnosis.sentence


def session(seed: int, shape: FloatArray) -> SessionCase:
    """A sweep with an error that has no name: one number for each posture of each mounting."""
    session_case = case(SWEEP, seed=seed)
    observations = session_case.observations
    off = (
        0.02
        * shape[observations.mount, np.unique(observations.displacement_mm, return_inverse=True)[1]]
    )
    return with_readings(session_case, observe(observations, observations.value_mm + off))


def shape(seed: int) -> FloatArray:
    mounts, levels = SWEEP.mount_count, len(np.unique(SWEEP.displacement_mm))
    return np.asarray(np.random.default_rng(seed).normal(size=(mounts, levels)))


def test_an_error_without_a_name_repeats_or_does_not() -> None:
    alike = [session(1, shape(7)), session(2, shape(7))]
    pattern = shared_pattern([Cells.of(item) for item in alike])
    assert pattern is not None
    assert pattern.reproducible
    assert pattern.p_value_directions < 1e-6
    assert pattern.p_value_permutations <= 0.01
    assert pattern.pairs[0].scale == pytest.approx(1.0, abs=0.1)
    assert pattern.pairs[0].after_rms_mm < 0.2 * pattern.pairs[0].before_rms_mm
    unlike = shared_pattern([Cells.of(alike[0]), Cells.of(session(3, shape(8)))])
    assert unlike is not None
    assert not unlike.reproducible
    assert abs(unlike.pairs[0].cosine) < 0.5
    assert shared_pattern([Cells.of(case(SWEEP, seed=1)), Cells.of(alike[0])]) is None


@LONG
def test_the_diagnosis_says_that_a_nameless_error_repeats() -> None:
    diagnosis = diagnose([session(1, shape(7)), session(2, shape(7))], CATALOGUE)
    assert diagnosis.verdict in ("unexplained", "partly-explained")
    assert (
        "It is reproducible: sessions 1 and 2 have the same residual pattern" in diagnosis.sentence
    )


def test_chance_of_two_directions_is_that_of_drawn_ones() -> None:
    pattern = shared_pattern([Cells.of(session(1, shape(7))), Cells.of(session(2, shape(8)))])
    assert pattern is not None
    drawn = np.random.default_rng(0).normal(size=(2, 20000, pattern.directions))
    first, second = drawn / np.linalg.norm(drawn, axis=2, keepdims=True)
    reached = np.abs((first * second).sum(axis=1)) >= abs(pattern.pairs[0].cosine)
    assert pattern.p_value_directions == pytest.approx(reached.mean(), abs=0.015)


def test_postures_that_only_one_session_has_do_not_count() -> None:
    first, second = session(1, shape(7)), session(2, shape(7))
    subset = first.observations.take(first.observations.displacement_mm != 22.0)
    fewer = shared_pattern([Cells.of(with_readings(first, subset)), Cells.of(second)])
    all_of_them = shared_pattern([Cells.of(first), Cells.of(second)])
    assert fewer is not None
    assert all_of_them is not None
    assert fewer.reproducible
    assert fewer.directions == all_of_them.directions - 6  # six set-ups at +22 mm
