"""Independent work in processes and on a cluster: the same results as one after the other."""

from __future__ import annotations

import subprocess
import sys

import joblib
import pytest

from calib.clusters import in_parallel
from tests.conftest import LONG, ROOT


def test_parts_come_in_their_order() -> None:
    assert list(in_parallel(abs, [-3, 2, -1])) == [3, 2, 1]
    with joblib.parallel_config(backend="threading", n_jobs=2):
        assert list(in_parallel(abs, [-3, 2, -1])) == [3, 2, 1]


@LONG
def test_a_search_on_a_cluster_finds_what_it_finds_here() -> None:
    pytest.importorskip("distributed", reason="the extra 'cluster' is not installed")
    words = [sys.executable, "-m", "tests.calib.cluster_search"]
    process = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False
    )
    assert process.returncode == 0, process.stderr
