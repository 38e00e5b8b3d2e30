"""Make the sample sessions again: python sample_sessions/make.py.

Sources are the tables beside this file and the simulation. Existing files are replaced. Times
and digests differ from run to run; values do not.

With ``--every-schema`` only the records of the schema that this program writes, for tests: every
event, every key. Those that exist are kept, as a later program could not write them.
"""

from __future__ import annotations

import sys
from datetime import date
from pathlib import Path

from app.measuring.simulated import simulated_session
from app.version import program
from calib.tripod.pipeline import Model
from protocols.journal import Journal, write_whole
from protocols.machine import load_machine
from protocols.procedure import guided_procedure_names, load_procedure
from protocols.session import (
    SCHEMA_NUMBER,
    Changed,
    Event,
    Faulted,
    Mounted,
    Moved,
    Noted,
    Reading,
    Restored,
    Session,
    Skipped,
    Superseded,
)
from protocols.table import checked_distances, distances_of_table, opened_table

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


def every_schema() -> None:
    """Small records of the present schema that hold each event and each key of it."""
    folder = HERE / "every_schema" / f"{SCHEMA_NUMBER}"
    folder.mkdir(parents=True, exist_ok=True)
    _measured(folder / "measured.jsonl", _simulated("orthoglide", "zero-max-min"))
    _whole(folder / "moved.jsonl", _simulated("orthoglide", "zero-max-min"), moved=True)
    _whole(folder / "plane.jsonl", _simulated("orthoglide", "zero-max-min-plane"))
    _whole(folder / "plate.jsonl", _simulated("linear-delta", "plate-rings"))
    _contacts(folder / "contacts.jsonl")


def _simulated(machine_name: str, procedure_name: str) -> Session:
    machine = load_machine(machine_name)
    procedure = load_procedure(procedure_name, machine.geometry())
    plate = procedure.plate and procedure.plate.model_copy(update={"lift_mm": 5.0})
    return simulated_session(
        procedure.model_copy(update={"cycles": 2, "plate": plate}),
        machine,
        Model(machine.geometry(), (*HIDDEN_MM[:3], 0.0, 0.0, 0.0)),
        seed=1,
        scatter_mm=0.002,
        resolution_mm=0.001,
    )


def _whole(path: Path, session: Session, *, moved: bool = False) -> None:
    if not path.exists():
        zero_mm = session.opened.machine.geometry().zero_mm.tolist()
        readings = session.readings
        write_whole(
            path,
            session.opened,
            [_moved(reading, zero_mm) for reading in readings] if moved else list(readings),
        )


def _contacts(path: Path) -> None:
    """Where a tool met a plate, and how far marks are apart, as tables have it."""
    if not path.exists():
        machine = load_machine("linear-delta")
        opened, events, _ = opened_table(HERE / "tables" / "contacts.csv", machine, program())
        measured = distances_of_table(HERE / "tables" / "distances.csv")
        opened = opened.model_copy(update={"measured_on": date(2026, 11, 26)})
        write_whole(path, opened, [*events, *checked_distances(measured, machine.geometry())])


def _moved(reading: Reading, zero_mm: list[float]) -> Reading:
    """As if a controller had sent the carriages there, from 1 mm below."""
    way_mm = [reading.displacement_mm if leg == reading.leg else 0.0 for leg in "xyz"]
    x, y, z = (zero + way for zero, way in zip(zero_mm, way_mm, strict=True))
    moved = Moved(
        driver="linuxcnc",
        coordinates="joint",
        from_mm=(x - 1.0, y - 1.0, z - 1.0),
        commanded_mm=(x, y, z),
        read_back_mm=(x, y, z),
        feed_mm_min=1500.0,
    )
    return reading.model_copy(update={"moved": moved})


def _measured(path: Path, session: Session) -> None:
    """What may happen while a person measures, an interruption among it."""
    if path.exists():
        return
    opened = session.opened.model_copy(
        update={
            "origin": "measured",
            "operator": "a sample",
            "temperature_c": 20.5,
            "verifies": "before.jsonl",
            "aligned_to": "x",
            "computer": "a computer",
            "remarks": ("Values are simulated.",),
        }
    )
    readings = [
        reading.model_copy(update={"temperature_c": 20.5, "extra": {"column": "of a table"}})
        for reading in session.readings
    ]
    first = readings[0]
    mounts = {reading.axis: reading.mount for reading in readings if reading.leg == first.leg}
    begun: list[Event] = [
        Changed(
            rail="y", towards="z", support_mm=100.0, asked_mm=0.2, moved_mm=0.19, reason="shims"
        ),
        Mounted(
            leg=first.leg,
            station=first.station,
            over_plane=False,
            mounts=mounts,
        ),
        *readings[:4],
        Faulted(step=3, axis="y", kind="no answer", text=""),
        Superseded(readings=(3, 4), reason="doubted"),
        Noted(text="The stand was touched."),
        Restored(readings=(3, 4), steps=(), reason="kept"),
    ]
    journal = Journal.create(path, opened)
    journal.append(*begun)
    journal.close()
    resumed = Journal.resume(path, program())
    last = max(reading.step or 0 for reading in readings)
    left_out = Skipped(steps=(last,), reason="time")
    resumed.append(*(reading for reading in readings[4:] if reading.step != last), left_out)
    resumed.finish(complete=False)


def _fresh(name: str) -> Path:
    path = HERE / f"{name}.jsonl"
    path.unlink(missing_ok=True)
    return path


if __name__ == "__main__":
    every_schema()
    if "--every-schema" in sys.argv:
        sys.exit()
    for experiment in PUBLISHED:
        published(experiment)
    for procedure in guided_procedure_names(load_machine(None).geometry()):
        simulated(procedure)
    damaged()
