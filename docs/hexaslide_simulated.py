"""The section on simulated calibrations: the verbs run as a person runs them."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hexaslide_page import table

from calib.hexaslide.procedures import Kind

POSTURES = "80"


def simulated_table(kinds: Sequence[Kind], machine_file: Path | None) -> str:
    """Simulate and solve once for each procedure."""
    own = () if machine_file is None else ("--machine-file", str(machine_file.absolute()))
    headings = [
        "procedure",
        "combinations",
        "residual, mm",
        "position at postures kept out, mm",
        "angle there, mrad",
        "constant motion left",
    ]
    with tempfile.TemporaryDirectory() as folder:
        return table(headings, [_row(kind, Path(folder), own) for kind in kinds])


def _row(kind: Kind, folder: Path, own: Sequence[str]) -> list[str]:
    measured, true = f"{kind.value}.json", f"{kind.value}-true.json"
    wanted = ("--procedure", kind.value, "--postures", POSTURES, "--truth", true, "--seed", "1")
    _glidecal(folder, "simulate", "-o", measured, "--machine", "hexaslide", *wanted, *own)
    found = json.loads(_glidecal(folder, "solve", measured, "--truth", true, "--json"))
    before, after = found["truth"]["before"], found["truth"]["after"]
    residuals = (found[when]["length_mm"] for when in ("rms_before", "rms_after"))
    return [
        kind.value,
        f"{found['rank']} of {found['parameter_count']}",
        " → ".join(_figure(value) for value in residuals),
        f"{before['position_rms_mm']:.3f} → {after['position_rms_mm']:.4f}",
        f"{before['angle_rms_mrad']:.3f} → {after['angle_rms_mrad']:.4f}",
        _motions(after) if found["lost_count"] else "none",
    ]


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


def _motions(apart: dict[str, Any]) -> str:
    said = (
        ("platform turned {:.2f} mrad", apart["platform_frame_turned_mrad"]),
        ("shifted {:.2f} mm", apart["platform_frame_shifted_mm"]),
        ("base turned {:.2f} mrad", apart["base_turned_mrad"]),
    )
    return ", ".join(words.format(size) for words, size in said if size > 0.0)


def _glidecal(folder: Path, *arguments: str) -> str:
    """Raises RuntimeError with its own words where the program refuses."""
    done = subprocess.run(
        [sys.executable, "-m", "app", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=False,
        timeout=120,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout
