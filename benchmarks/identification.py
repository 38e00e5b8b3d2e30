"""Identification of one session and of very many, beside other solvers in the same run.

The peers get the session as it is: 60 raw readings, 6 parameters and 6 zeros, one vectorised
residual through the exact pipeline. One more row gives scipy our own means and derivatives, which
is most of the difference. ``lmfit`` and ``iminuit``: ``pip install -e .[bench]``.
"""

from __future__ import annotations

import importlib
import importlib.util
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from benchmarks.page import seconds
from calib.arrays import FloatArray, Observations
from calib.identify.fit import PlainFit
from calib.identify.monte_carlo import CHUNK
from calib.identify.solution import SUBSETS
from calib.newton import Optimum
from calib.tripod.geometry import PARAMETER_NAMES
from calib.tripod.pipeline import Model, simulate
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_sessions" / "simulated_zero-max-min.jsonl"
SWEEPS = 2000
MANY = 100_000


def table() -> list[str]:
    """Every table of this file."""
    return [*one_session(), "", *many_sessions()]


def one_session() -> list[str]:
    """One standard session by several solvers, from zero, same residual."""
    observations = to_observations([fold(read_record(SAMPLE).events)])
    unknown = len(PARAMETER_NAMES) + observations.mount_count

    def residual(x: FloatArray) -> FloatArray:
        modelled = simulate(Model().geometry, x[:6], observations) + x[6:][observations.mount]
        return np.asarray(modelled - observations.value_mm)

    fit = PlainFit(Model(), observations, SUBSETS["both"], observations.averaged)
    values = observations.value_mm[:, None]
    ours = _ours(fit.solve(values))
    rows: list[tuple[str, float, FloatArray]] = [
        ("glidecal, design prepared", seconds(lambda: fit.solve(values), 21), ours),
        ("glidecal, design made anew", seconds(lambda: _anew(observations), 21), ours),
    ]
    peers = _peers(residual, unknown) | {
        "scipy, our 18 means and derivatives": lambda: _scipy_on_means(fit, values)
    }
    for name, solve in peers.items():
        rows.append((name, seconds(solve), solve()[:6]))
    best = rows[0][1]
    missing = [f"| {name} | not installed | | |" for name in _not_installed()]
    return [
        "| one session: 60 raw readings, 6 zeros, 6 parameters | ms | ratio | off by, mm |",
        "|---|---|---|---|",
        *(
            f"| {name} | {1e3 * time_s:.3f} | {time_s / best:.1f} | {np.abs(x - ours).max():.1e} |"
            for name, time_s, x in rows
        ),
        *missing,
    ]


def _not_installed() -> list[str]:
    return [name for name in ("lmfit", "iminuit") if not importlib.util.find_spec(name)]


def _ours(optimum: Optimum) -> FloatArray:
    return optimum.values[:, 0]


def _anew(observations: Observations) -> Optimum:
    fit = PlainFit(Model(), observations, SUBSETS["both"], observations.averaged)
    return fit.solve(observations.value_mm[:, None])


def _peers(
    residual: Callable[[FloatArray], FloatArray], unknown: int
) -> dict[str, Callable[[], FloatArray]]:
    start = np.zeros(unknown)
    methods: dict[str, Callable[[], FloatArray]] = {
        "scipy least_squares, trf": lambda: np.asarray(least_squares(residual, start).x),
        "scipy least_squares, lm": lambda: np.asarray(
            least_squares(residual, start, method="lm").x
        ),
        f"coordinate descent, {SWEEPS} sweeps at most": lambda: _descent(residual, start),
    }
    if importlib.util.find_spec("lmfit"):
        methods["lmfit, leastsq"] = lambda: _lmfit(residual, unknown)
    if importlib.util.find_spec("iminuit"):
        methods["iminuit, migrad"] = lambda: _iminuit(residual, start)
    return methods


def _scipy_on_means(fit: PlainFit, values: FloatArray) -> FloatArray:
    measured = (fit.whiten @ (fit.average @ values))[:, 0]

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(fit.whiten @ fit.design.readings(x[:, None])[:, 0] - measured)

    def jacobian(x: FloatArray) -> FloatArray:
        slope = fit.design.readings_and_derivatives(x[:, None])[1][:, :, 0]
        return np.asarray(fit.whiten @ slope.T)

    return np.asarray(least_squares(residual, np.zeros(6), jac=jacobian).x)


def _lmfit(residual: Callable[[FloatArray], FloatArray], unknown: int) -> FloatArray:
    lmfit: Any = importlib.import_module("lmfit")
    parameters = lmfit.Parameters()
    for k in range(unknown):
        parameters.add(f"p{k}", value=0.0)
    result = lmfit.minimize(
        lambda p: residual(np.array([p[f"p{k}"].value for k in range(unknown)])), parameters
    )
    return np.array([result.params[f"p{k}"].value for k in range(unknown)])


def _iminuit(residual: Callable[[FloatArray], FloatArray], start: FloatArray) -> FloatArray:
    iminuit: Any = importlib.import_module("iminuit")
    minuit = iminuit.Minuit(lambda x: float((residual(x) ** 2).sum()) / 1e-6, start)
    minuit.errordef = 1.0
    minuit.migrad()
    return np.array(minuit.values)


def _descent(residual: Callable[[FloatArray], FloatArray], start: FloatArray) -> FloatArray:
    """One parameter after the other, step up or down, halved when neither helps."""
    x, step = start.copy(), np.full(len(start), 0.1)
    best = float((residual(x) ** 2).sum())
    for _ in range(SWEEPS):
        for k in range(len(x)):
            for sign in (1.0, -1.0):
                trial = x.copy()
                trial[k] += sign * step[k]
                cost = float((residual(trial) ** 2).sum())
                if cost < best:
                    x, best = trial, cost
                    step[k] *= 1.5
                    break
            else:
                step[k] *= 0.5
        if step.max() < 1e-9:
            break
    return x


def many_sessions() -> list[str]:
    """A hundred thousand and a million sessions, each count in a process of its own, one core."""
    rows = []
    for count in (MANY, 10 * MANY):
        process = subprocess.run(
            [sys.executable, "-m", "benchmarks.identification", str(count)],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
            env={"OPENBLAS_NUM_THREADS": "1", "PATH": ""},
        )
        time_s, memory, failed = process.stdout.split()
        rows.append(f"| {count:,} | {float(time_s):.2f} | {float(memory):.0f} | {failed} |")
    return [
        "| exact identifications, one core | s | peak memory, MB | failed |",
        "|---|---|---|---|",
        *rows,
    ]


def identify_so_many(count: int) -> None:
    """Identify simulated sessions chunk by chunk; print seconds, peak MB and failures."""
    observations = to_observations([fold(read_record(SAMPLE).events)])
    fit = PlainFit(Model(), observations, SUBSETS["both"], observations.averaged)
    place = np.argmax(fit.average > 0.0, axis=0)
    generator = np.random.default_rng(1)
    time_s, failed, chunk = 0.0, 0, 20_000
    for _ in range(0, count, chunk):
        truth = np.vstack(
            [generator.uniform(-2, 2, (3, chunk)), generator.normal(0, 0.03, (3, chunk))]
        )
        values = fit.design.readings(truth)[place]
        values = values + generator.normal(scale=0.002, size=values.shape)
        start = time.perf_counter()
        parts = [values[:, first : first + CHUNK] for first in range(0, chunk, CHUNK)]
        converged = [fit.solve(part).converged for part in parts]
        time_s += time.perf_counter() - start
        failed += int((~np.concatenate(converged)).sum())
    print(time_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0, failed)


if __name__ == "__main__":
    identify_so_many(int(sys.argv[1]))
