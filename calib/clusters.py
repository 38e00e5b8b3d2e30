"""Independent work that may be spread over processes or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

on_part: ContextVar[Callable[[float, int], object]] = ContextVar(
    "on_part", default=lambda _count, _parts: None
)
"""Is told how many parts are done, and perhaps a share of the next, of how many: whoever waits may
set it.
"""


def in_parallel(work: Callable[[T], R], parts: Sequence[T]) -> Generator[R]:
    """What ``work`` makes of each part, in their order.

    One after the other, here, unless the caller asked joblib for more: within ``with
    joblib.parallel_config(n_jobs=4):`` it runs in four processes, with ``backend="dask"`` on a
    cluster of dask.
    """
    results: Iterable[R] = map(work, parts)
    if len(parts) > 1:
        from joblib import Parallel, delayed  # as slow to load as a whole search of few postures

        results = Parallel(return_as="generator")(delayed(work)(part) for part in parts)
    for count, result in enumerate(results, start=1):
        on_part.get()(count, len(parts))
        yield result


def on_processors(count: int) -> AbstractContextManager[object]:
    """Within it `in_parallel` works in so many processes; one: here, as the caller asked before."""
    if count < 2:
        return nullcontext()
    from joblib import parallel_config

    context: AbstractContextManager[object] = parallel_config("loky", n_jobs=count)
    return context
