"""Options that several verbs share."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from typer.models import OptionInfo

from protocols.machine_files import USUAL_MACHINE, machine_names


class SubsetName(StrEnum):
    """Which parameters to identify."""

    JOINT_OFFSETS = "joint-offsets"
    LEG_LENGTHS = "leg-lengths"
    BOTH = "both"
    WITH_TOLERANCES = "with-tolerances"


class MethodName(StrEnum):
    """How to identify."""

    LINEAR = "linear"
    EXACT = "exact"


class WeightsName(StrEnum):
    """Weighting of the linear method."""

    EQUAL = "equal"
    COVARIANCE = "covariance"


# readable=False: our own message and exit status for a file without permission
Sessions = Annotated[
    list[Path], typer.Argument(help="Session files.", show_default=False, readable=False)
]
OneSession = Annotated[
    Path, typer.Argument(help="Session file.", show_default=False, readable=False)
]
Output = Annotated[
    Path,
    typer.Option("--output", "-o", help="File to write.", show_default=False, readable=False),
]
Machine = Annotated[
    str | None,
    typer.Option(
        "--machine",
        help=f"{', '.join(machine_names())}, or a machine file (TOML).",
        show_default=USUAL_MACHINE,
    ),
]
Protocol = Annotated[
    str | None,
    typer.Option(
        "--protocol",
        help="Procedure by name, or a .toml file of your own.",
        show_default="the machine's",
    ),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of the simulation.")]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON document on standard output.")]
ProfileName = Annotated[str, typer.Option("--profile", help="Indicator profile.")]
Unit = Annotated[str, typer.Option("--unit", help="Unit of the display: mm, inch or µm.")]
Channel = Annotated[int, typer.Option("--channel", min=1, max=99, help="Input of an interface.")]
Subset = Annotated[
    SubsetName | None,
    typer.Option("--subset", help="Parameters to identify; default: the recommended set."),
]
Method = Annotated[
    MethodName,
    typer.Option("--method", help="linear: system (11); exact: nonlinear, raw readings."),
]


def finite(value: float | None) -> float | None:
    """Refuse NaN, which no range excludes, and infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter("a finite number is needed")
    return value


def figure(help_text: str) -> OptionInfo:
    """An option for a small length of an indicator, mm."""
    option: OptionInfo = typer.Option(help=help_text, min=0.0, max=10.0, callback=_no_trace)
    return option


def _no_trace(value_mm: float | None) -> float | None:
    """Refuse what is neither 0 nor a length that any indicator could have."""
    from protocols.documents import LEAST_FIGURE_MM

    if value_mm and value_mm < LEAST_FIGURE_MM:
        raise typer.BadParameter(f"0, or {LEAST_FIGURE_MM:g} mm at least")
    return finite(value_mm)


def parts(listed: str) -> tuple[str, ...]:
    """What stands between commas."""
    return tuple(part.strip() for part in listed.split(",")) if listed.strip() else ()


def say(text: str) -> None:
    """Progress and warnings go to standard error."""
    typer.echo(text, err=True)


Measured = Annotated[str, typer.Option(help="Hexa Slide: what is measured, such as x,y,z,theta.")]
Known = Annotated[
    str | None,
    typer.Option(
        help="Constraint link: what is known of c,d,length, or none.", show_default="length"
    ),
]
