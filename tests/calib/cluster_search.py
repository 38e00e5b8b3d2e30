"""A search here and on a local cluster of dask: ends with 0 where both find the same.

A process of its own: dask leaves threads behind that end with it.
"""

from __future__ import annotations

import sys

import distributed
import joblib
import numpy as np

from calib.hexaslide.procedures import Procedure
from calib.hexaslide.search import BestPostures, Search, best_postures
from protocols.hexaslide import load_hexaslide


def search() -> BestPostures:
    """A short search from two starts."""
    machine = load_hexaslide().whole()
    return best_postures(Procedure.of("pose-inverse"), machine, 9, Search(seed=3, starts=2))


def main() -> int:
    """Compare."""
    here = search()
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    )
    with cluster, distributed.Client(cluster), joblib.parallel_config(backend="dask"):
        there = search()
    equal = np.array_equal(there.refined.coordinates, here.refined.coordinates)
    return 0 if equal and there.values == here.values else 1


if __name__ == "__main__":
    sys.exit(main())
