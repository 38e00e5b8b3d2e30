"""``sample_sessions/hexaslide/``, on which docs/hexaslide.md is walked by a test:
``python -m tests.app.commands.hexaslide_samples``.

Two tables as the owner of a tracker fills them in, of one hidden machine: sliders as a controller
with the example's geometry sends them, and as one with the calibrated geometry does.
"""

from __future__ import annotations

import csv
import sys
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

from app.evaluating.hexaslide_calibration import calibrate_file
from app.exports.hexaslide import calibrated_files
from app.measuring.hexaslide import import_postures
from protocols.hexaslide import HexaSlideMachine, load_hexaslide, machine_like
from protocols.hexaslide_session import SimulatedPostures, commands, load_posture_procedure
from protocols.hexaslide_table import empty_table
from tests.app.commands.posture_sessions import opened
from tests.conftest import ROOT

FOLDER = ROOT / "sample_sessions" / "hexaslide"
SEED = 12


def filled_in(nominal: HexaSlideMachine, truth: HexaSlideMachine, seed: int) -> str:
    """The table of the procedure with what the true machine shows, its controller holding that."""
    targets = commands(nominal, load_posture_procedure("position"))
    operator = SimulatedPostures(nominal, targets, seed, truth)
    rows = list(csv.reader(StringIO(empty_table(targets))))
    for number, row in enumerate(rows[2:], start=1):
        row[7:] = [f"{float(value):.4f}" for value in operator.typed(number, 0).split()]
    out = StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def main(folder: Path = FOLDER) -> None:
    """Write both tables."""
    example = load_hexaslide()
    targets = commands(example, load_posture_procedure("position"))
    hidden = SimulatedPostures(example, targets, SEED).truth
    truth = machine_like(example, "hidden", hidden)
    before = filled_in(example, truth, SEED)
    (folder / "before.csv").write_text(before, encoding="utf-8")
    with TemporaryDirectory() as scratch:
        session, calibrated = Path(scratch, "s.jsonl"), Path(scratch, "m.toml")
        import_postures(folder / "before.csv", session, opened("position"))
        files = calibrated_files(calibrate_file(session, None, 0.0), None)
        calibrated.write_text(str(files["machine.toml"]), encoding="utf-8")
        after = filled_in(load_hexaslide(calibrated), truth, SEED + 1)
    (folder / "after.csv").write_text(after, encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
