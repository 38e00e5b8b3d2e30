"""Independent work that may be spread over processes or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")


def in_parallel(work: Callable[[T], R], parts: Sequence[T]) -> Iterator[R]:
    """What ``work`` makes of each part, in their order.

    One after the other, here, unless the caller asked joblib for more: within ``with
    joblib.parallel_config(n_jobs=4):`` it runs in four processes, with ``backend="dask"`` on a
    cluster of dask.
    """
    if len(parts) < 2:
        yield from map(work, parts)
        return
    from joblib import Parallel, delayed  # as slow to load as a whole search of few postures

    yield from Parallel(return_as="generator")(delayed(work)(part) for part in parts)
