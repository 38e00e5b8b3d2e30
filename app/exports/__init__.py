"""Offsets for controllers: as JSON, as CSV, as a model, for LinuxCNC and firmware of printers.

May import `app.report` and what that may import.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.evaluating.solution import SessionSolution
from app.exports import linuxcnc, m665, towers
from app.report.offsets import Export, Offsets, for_controller, moves_the_tool, offsets_from_result
from app.report.schema.document import to_json
from app.report.schema.offsets import OffsetsReport
from protocols.data_table import csv_text
from protocols.files import write_files
from protocols.model_file import model_file


def as_json(offsets: Offsets) -> Export:
    """Schema ``glidecal.offsets/1``: joint offsets, and all that the firmware of a printer holds.

    Effects of a model are not in it.
    """
    offsets = for_controller(offsets, "offsets", moves_the_tool(offsets.model))
    text = to_json(OffsetsReport.of(offsets)) + "\n"
    return Export({"": text}, offsets.cautions)


def as_model(offsets: Offsets) -> Export:
    """Schema ``glidecal.model/1``: for ``glidecal simulate --model``."""
    offsets = for_controller(offsets, "kinematics")
    text = model_file(offsets.model, offsets.machine, offsets.cautions).text()
    return Export({"": text}, offsets.cautions)


def as_csv(offsets: Offsets) -> Export:
    """One row a joint offset, below the cautions as ``#`` lines; point as decimal mark.

    An unknown uncertainty stays empty; effects of a model are not in it.
    """
    offsets = for_controller(offsets, "offsets", moves_the_tool(offsets.model))
    rows: list[Sequence[str]] = [
        (
            "parameter",
            "value_mm",
            "standard_uncertainty_mm",
            "expanded_uncertainty_mm",
            "expanded_with_lack_of_fit_mm",
        )
    ]
    for name, parameter in offsets.parameters.items():
        figures_mm = (
            parameter.value,
            parameter.standard_uncertainty,
            parameter.expanded_uncertainty,
            parameter.expanded_with_lack_of_fit,
        )
        rows.append((name, *("" if mm is None else f"{mm:z.6f}" for mm in figures_mm)))
    origin_line = [f"{offsets.source}, {offsets.made}"] if offsets.made else []
    less = any(
        parameter.standard_uncertainty is not None
        and parameter.expanded_uncertainty is not None
        and parameter.expanded_uncertainty < parameter.standard_uncertainty
        for parameter in offsets.parameters.values()
    )
    remarks = [*origin_line, *([OF_MIXTURE] if less else []), *offsets.cautions]
    return Export({"": csv_text(rows, remarks)}, offsets.cautions)


OF_MIXTURE = (
    "An expanded uncertainty is half of the 95 % interval over all models. It is less "
    "than the standard one where a model of little weight is far off."
)


FORMATS = {
    "json": as_json,
    "csv": as_csv,
    "model": as_model,
    "linuxcnc": linuxcnc.joint_includes,
    "linuxcnc-kins": linuxcnc.with_kinematics,
    "lineardeltakins": towers.joints_and_pins,
    "klipper": towers.printer_cfg,
    "reprapfirmware": m665.config_g,
    "marlin": m665.marlin,
    "smoothieware": m665.smoothieware,
    "p-3z": towers.p_3z,
}
"""Each takes offsets and gives the files to write, by name ('' is the path itself)."""

IN_FOLDERS = ("linuxcnc", "linuxcnc-kins", "lineardeltakins")
"""Of these, what writes several files."""

FILE_NAMES = {"json": "offsets.json", "csv": "offsets.csv", "model": "model.json"}


def export_offsets(result: SessionSolution, folder: Path, *, replace: bool = False) -> list[Path]:
    """The correction of sessions in every format, into a folder. Raises as `write_files`.

    Where the machine file has heights of switches, as firmware of printers does, in its formats.
    """
    offsets = offsets_from_result(result)
    files = {file: FORMATS[name](offsets).files[""] for name, file in FILE_NAMES.items()}
    if offsets.machine.position_endstop_mm:
        files["klipper.cfg"] = towers.printer_cfg(offsets).files[""]
        files["reprapfirmware.g"] = m665.config_g(offsets).files[""]
        files["marlin.g"] = m665.marlin(offsets).files[""]
    else:
        files |= linuxcnc.joint_includes(offsets).files
    return write_files(folder, files, replace=replace)
