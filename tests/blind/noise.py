"""Noise of the blind sessions: what real indicators do, not only Gaussian scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tests.blind.forward import FloatArray, Rows

NOISES = ("gaussian", "quantised", "heavy", "unequal", "locked", "wander")
RESOLUTION_MM = 0.001
WANDER_TIME_S = 300.0
WANDER_SHARE = 0.7


@dataclass(frozen=True, eq=False)
class Noise:
    """One draw: values ``(n,)``, their expected r.m.s., and the indicators' resolution."""

    values_mm: FloatArray
    rms_mm: float
    resolution_mm: float | None = None


def draw(kind: str, rows: Rows, sigma_mm: float, rng: np.random.Generator) -> Noise:
    """Noise of one kind for these rows; ``sigma_mm`` is the scatter of one reading."""
    plain = sigma_mm * rng.standard_normal(len(rows))
    match kind:
        case "gaussian":
            return Noise(plain, sigma_mm)
        case "quantised":
            rms = float(np.hypot(sigma_mm, RESOLUTION_MM / np.sqrt(12)))
            return Noise(plain, rms, RESOLUTION_MM)
        case "heavy":
            return Noise(sigma_mm * rng.standard_t(5, len(rows)) / np.sqrt(5 / 3), sigma_mm)
        case "unequal":
            return _unequal(rows, plain, sigma_mm, rng)
        case "locked":
            return _locked(rows, plain, sigma_mm, rng)
        case "wander":
            return _wandering(rows, plain, sigma_mm, rng)
    raise ValueError(f"noise {kind!r}: one of {', '.join(NOISES)}")


def _unequal(rows: Rows, plain: FloatArray, sigma_mm: float, rng: np.random.Generator) -> Noise:
    """Each mounting's indicator scatters by a factor of its own."""
    factors = rng.uniform(0.5, 1.8, rows.mount.max() + 1)[rows.mount]
    return Noise(factors * plain, sigma_mm * float(np.sqrt(np.mean(factors**2))))


def _locked(rows: Rows, plain: FloatArray, sigma_mm: float, rng: np.random.Generator) -> Noise:
    """As much again is drawn once for each posture driven to; repeats in place share it."""
    per_visit = sigma_mm * rng.standard_normal((rows.visit.max() + 1, 3))
    return Noise(plain + per_visit[rows.visit, rows.axis], sigma_mm * float(np.sqrt(2)))


def _wandering(rows: Rows, plain: FloatArray, sigma_mm: float, rng: np.random.Generator) -> Noise:
    """Each mounting wanders to and fro over some minutes."""
    slow = np.zeros(len(rows))
    for mount in range(rows.mount.max() + 1):
        gauge_rows = np.flatnonzero(rows.mount == mount)
        slow[gauge_rows] = _wander(rows.time_s[gauge_rows], rng)
    size = WANDER_SHARE * sigma_mm
    return Noise(plain + size * slow, float(np.hypot(sigma_mm, size)))


def _wander(time_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """A wander of unit variance that forgets itself within ``WANDER_TIME_S``."""
    values = [float(rng.standard_normal())]
    for pause in np.diff(time_s):
        persistence = float(np.exp(-pause / WANDER_TIME_S))
        values.append(
            persistence * values[-1] + float(np.sqrt(1 - persistence**2) * rng.standard_normal())
        )
    return np.array(values)
