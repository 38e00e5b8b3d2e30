"""Options that several verbs share."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer


class SubsetName(StrEnum):
    """Which parameters to identify."""

    JOINT_OFFSETS = "joint-offsets"
    LEG_LENGTHS = "leg-lengths"
    BOTH = "both"


class MethodName(StrEnum):
    """How to identify."""

    LINEAR = "linear"
    EXACT = "exact"


class WeightsName(StrEnum):
    """Weighting of the linear method."""

    EQUAL = "equal"
    COVARIANCE = "covariance"


Sessions = Annotated[list[Path], typer.Argument(help="Session files.", show_default=False)]
OneSession = Annotated[Path, typer.Argument(help="Session file.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", help="File to write.", show_default=False)]
Machine = Annotated[Path | None, typer.Option("--machine", help="Machine file (TOML).")]
Protocol = Annotated[
    str, typer.Option("--protocol", help="Procedure by name, or a .toml file of your own.")
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the simulation.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]
Subset = Annotated[
    SubsetName | None,
    typer.Option("--subset", help="Parameters to identify; default: the recommended set."),
]
Method = Annotated[
    MethodName,
    typer.Option("--method", help="linear: system (11); exact: nonlinear, raw readings."),
]


def say(text: str) -> None:
    """Progress and warnings go to standard error."""
    typer.echo(text, err=True)
