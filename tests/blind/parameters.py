"""Parameters of a named effect against the hidden amounts, whatever unit the document uses."""

from __future__ import annotations

import math
from typing import Any

from scipy import stats

from tests.blind.forward import LEG_MM

Json = dict[str, Any]

# Dimension and factor to mm, rad, s.
UNITS: dict[str, tuple[str, float]] = {
    "mm": ("length", 1.0),
    "µm": ("length", 1e-3),
    "": ("ratio", 1.0),
    "1": ("ratio", 1.0),
    "rad": ("ratio", 1.0),
    "mm/mm": ("ratio", 1.0),
    "mrad": ("ratio", 1e-3),
    "mm/m": ("ratio", 1e-3),
    "µrad": ("ratio", 1e-6),
    "µm/m": ("ratio", 1e-6),
    "ppm": ("ratio", 1e-6),
    "%": ("ratio", 1e-2),
    "°": ("ratio", math.pi / 180),
    "1/mm": ("curvature", 1.0),
    "mm/mm²": ("curvature", 1.0),
    "1/m": ("curvature", 1e-3),
    "µm/mm²": ("curvature", 1e-3),
    "mm/m²": ("curvature", 1e-6),
    "µm/m²": ("curvature", 1e-9),
    "mm/s": ("rate", 1.0),
    "µm/s": ("rate", 1e-3),
    "mm/min": ("rate", 1 / 60),
    "µm/min": ("rate", 1e-3 / 60),
    "mm/h": ("rate", 1 / 3600),
    "µm/h": ("rate", 1e-3 / 3600),
}
DIMENSION = {
    "lean": "ratio",
    "distance": "length",
    "curve": "curvature",
    "s_guide": "length",
    "clearance": "length",
    "round": "curvature",
    "lag": "length",
    "stand": "rate",
    "scale": "ratio",
    "sine": "length",
    "cosine": "length",
    "lost": "length",
    "sag": "length",
    "drift": "rate",
    "taper": "ratio",
    "bow": "curvature",
    "gain": "ratio",
    "tilt": "ratio",
}
# Which way is positive is not fixed by the contract.
EITHER_SIGN = {"taper", "bow", "tilt"}
LETTERS = "xyz"


def covered(effect: Json, truth: Json, noise_dof: float | None) -> list[bool]:
    """For each parameter that can be compared: whether its 95 % interval holds the truth."""
    entry = truth["parameters"][0]["entry"]
    parameters = _in_order([p for p in map(_plain, effect["parameters"]) if _fits(p, entry)])
    if any("amplitude" in p["name"] for p in parameters):
        return _amplitude(parameters, truth, noise_dof)
    amounts = _amounts(truth, len(parameters))
    if amounts is None:
        return []
    names = [p["entry"] for p in truth["parameters"]][: len(parameters)]
    pairs = zip(parameters, amounts, names, strict=True)
    return [_inside(p, amount, name, noise_dof) for p, amount, name in pairs]


def _plain(parameter: Json) -> Json:
    dimension, factor = UNITS.get(parameter["unit"].replace("^2", "²"), ("unknown", 1.0))
    return {
        "name": parameter["name"].lower(),
        "dimension": dimension,
        "value": parameter["value"] * factor,
        "error": (parameter["standard_uncertainty"] or math.inf) * factor,
    }


def _fits(parameter: Json, entry: str) -> bool:
    """Whether it is a size of this effect at all: a lead is not, nor is a phase."""
    if any(word in parameter["name"] for word in ("lead", "period", "phase")):
        return False
    if entry == "bow" and parameter["dimension"] == "length":
        parameter["value"] *= 4 / LEG_MM**2  # height in the middle of the bar
        parameter["error"] *= 4 / LEG_MM**2
        return math.isfinite(parameter["error"])
    if entry == "curve" and "at_100mm" in parameter["name"]:
        parameter.update(
            dimension="curvature", value=parameter["value"] / 1e4, error=parameter["error"] / 1e4
        )
    return parameter["dimension"] == DIMENSION[entry] and math.isfinite(parameter["error"])


def _in_order(parameters: list[Json]) -> list[Json]:
    """By the axis that ends each name, where all of them end so."""
    ends = [p["name"][-1:] for p in parameters]
    if all(end in LETTERS for end in ends) and len(set(ends)) == len(ends):
        return sorted(parameters, key=lambda p: str(p["name"][-1:]))
    return parameters


def _amounts(truth: Json, count: int) -> list[float] | None:
    """The hidden amounts, or the one that all legs share; None where they do not correspond."""
    amounts = [float(p["value"]) for p in truth["parameters"]]
    if count == len(amounts):
        return amounts
    alike = max(amounts) - min(amounts) <= 1e-9 * max(abs(a) for a in amounts)
    return amounts[:1] if count == 1 and alike else None


def _amplitude(parameters: list[Json], truth: Json, noise_dof: float | None) -> list[bool]:
    by_entry: dict[str, float] = {}
    for p in truth["parameters"]:
        by_entry[p["entry"]] = p["value"]
    amount = math.hypot(*by_entry.values())
    sizes = [p for p in parameters if "amplitude" in p["name"]]
    return [_inside(p, amount, "sine", noise_dof) for p in sizes]


def _inside(parameter: Json, amount: float, entry: str, noise_dof: float | None) -> bool:
    factor = float(stats.t.ppf(0.975, noise_dof)) if noise_dof else 1.96
    reach = factor * parameter["error"]
    signs = (1.0, -1.0) if entry in EITHER_SIGN else (1.0,)
    return any(abs(parameter["value"] - sign * amount) <= reach for sign in signs)
