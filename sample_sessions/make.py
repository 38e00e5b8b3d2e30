"""Make the sample sessions again: python sample_sessions/make.py.

Sources are the tables beside this file and the simulation. Existing files are replaced. Times
and digests differ from run to run; values do not.
"""

from __future__ import annotations

from pathlib import Path

from app.measuring.simulated import simulated_session
from app.version import program
from calib.tripod.pipeline import Model
from protocols.journal import write_whole
from protocols.machine import load_machine
from protocols.procedure import guided_procedure_names, load_procedure
from protocols.table import opened_table

HERE = Path(__file__).parent
SOURCE = "Pashkevich, Chablat, Wenger, Gomolitsky 2008, tables {}; three readings averaged."
ASSEMBLED = "As assembled, before mechanical tuning."
TUNED = "After the actuator axes were re-tuned, before calibration."
ENTERED = "Joint offsets of experiment 2 entered in the controller."
CONFLICT = (
    "Tables 1 and 2 disagree for experiment 3 in five of six differences, most in z_y Max minus "
    "Min: +0.11 in table 1, -0.48 in table 2. No change of signs in table 2 mends that."
)
X_Z_1 = "x_z +1.58 contradicts the printed r.m.s. 1.19 and residuals; +1.48 fits them. "
X_Z_3 = "x_z- -0.19 contradicts the printed predictions; -0.13 fits them. "
CORRECTED = "Corrected here; experiment_{} is as printed."
PRINTED = "As printed; experiment_{}_corrected is not."
PUBLISHED = {
    "experiment_1_six": ("1", ASSEMBLED, X_Z_1 + PRINTED.format("1_six")),
    "experiment_1_six_corrected": ("1", ASSEMBLED, X_Z_1 + CORRECTED.format("1_six")),
    "experiment_2_six": ("1", TUNED),
    "experiment_2_twelve": ("2", TUNED),
    "experiment_3_six": ("1", ENTERED, CONFLICT),
    "experiment_3_twelve": ("2", ENTERED, CONFLICT, X_Z_3 + PRINTED.format("3_twelve")),
    "experiment_3_twelve_corrected": (
        *("2", ENTERED, CONFLICT),
        X_Z_3 + CORRECTED.format("3_twelve"),
    ),
}
RESOLUTION_MM = 0.01
REPEATABILITY_MM = 0.02
HIDDEN_MM = (0.85, -1.3, 0.4, 0.02, -0.03, 0.01)


def published(name: str) -> None:
    """One published experiment as a session."""
    table, *remarks = PUBLISHED[name]
    opened, events, _ = opened_table(
        HERE / "tables" / f"{name}.csv",
        load_machine(None),
        program(),
        resolution_mm=RESOLUTION_MM,
        repeatability_mm=REPEATABILITY_MM,
        remarks=(SOURCE.format(table), *remarks),
    )
    write_whole(_fresh(name), opened, list(events))


def simulated(name: str) -> None:
    """One simulated session of a procedure."""
    machine = load_machine(None)
    opened, readings = simulated_session(
        load_procedure(name, machine.geometry()),
        machine,
        Model(machine.geometry(), HIDDEN_MM),
        seed=1,
        scatter_mm=0.002,
        resolution_mm=0.001,
    )
    write_whole(_fresh(f"simulated_{name}"), opened, list(readings))


def damaged() -> None:
    """A session in which a value on line 9 was changed by hand."""
    lines = (HERE / "simulated_zero-max-min.jsonl").read_text(encoding="utf-8").splitlines(True)
    lines[8] = lines[8].replace('"cycle":', '"cycle":1', 1)
    (HERE / "damaged.jsonl").write_text("".join(lines), encoding="utf-8", newline="\n")


def _fresh(name: str) -> Path:
    path = HERE / f"{name}.jsonl"
    path.unlink(missing_ok=True)
    return path


if __name__ == "__main__":
    for experiment in PUBLISHED:
        published(experiment)
    for procedure in guided_procedure_names(load_machine(None).geometry()):
        simulated(procedure)
    damaged()
