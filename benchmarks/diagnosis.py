"""A diagnosis as a whole process, beside reading its file alone: time and peak memory."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

from protocols.record import read_record
from protocols.session import fold

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_sessions" / "simulated_sweep.jsonl"
CYCLES = (4, 72, 720)
"""Of a sweep: about 280, 5,000 and 50,000 readings."""
SCATTER_MM = 0.002
COLUMNS = ("leg", "axis", "displacement_mm", "station")
ROUNDS = 3


@dataclass(frozen=True)
class Cost:
    """Processor time of one process and its children, s, and its peak memory, MB."""

    processor_s: float
    peak_mb: float


def cost(*arguments: str) -> Cost:
    """The median of a few runs; what the process prints is thrown away."""
    runs = sorted((_once(*arguments) for _ in range(ROUNDS)), key=lambda run: run.processor_s)
    return runs[ROUNDS // 2]


def _once(*arguments: str) -> Cost:
    code = (
        "import json, resource, subprocess, sys; "
        "subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL); "
        "used = resource.getrusage(resource.RUSAGE_CHILDREN); "
        "print(json.dumps([used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))"
    )
    one_thread = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", code, sys.executable, *arguments]
    done = subprocess.run(
        command, capture_output=True, check=True, cwd=ROOT, env=os.environ | one_thread, text=True
    )
    return Cost(*json.loads(done.stdout))


def diagnosis() -> list[str]:
    """Sessions of a sweep, of more and more readings."""
    lines = [
        "| diagnosis of so many readings | reading the file, s | diagnose, s | more, s "
        "| peak memory, MB |",
        "|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for cycles in CYCLES:
            session = _session(Path(folder), cycles)
            read = cost("-m", "app", "validate", str(session))
            total = cost("-m", "app", "diagnose", str(session), "--json")
            count = len(fold(read_record(session).events).readings)
            lines.append(
                f"| {count} | {read.processor_s:.2f} | {total.processor_s:.2f} "
                f"| {total.processor_s - read.processor_s:.2f} | {total.peak_mb:.0f} |"
            )
    return lines


def _session(folder: Path, cycles: int) -> Path:
    """A simulated sweep of so many cycles: that of the samples again and again, scattered anew."""
    source, readings = str(SAMPLE), folder / "readings.csv"
    command = ["-m", "app", "export", source, "--table", "readings", "--format", "csv", "--force"]
    subprocess.run([sys.executable, *command, "-o", str(readings)], check=True, cwd=ROOT)
    with readings.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    cycle_count = max(int(row["cycle"]) for row in rows)
    scatter = np.random.default_rng(cycles).normal(0.0, SCATTER_MM, (cycles, len(rows)))
    table, session = folder / f"{cycles}.csv", folder / f"{cycles}.jsonl"
    with table.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*COLUMNS, "value_mm", "cycle"])
        for mount in dict.fromkeys((row["leg"], row["station"]) for row in rows):
            for cycle, row_number in product(range(0, cycles, cycle_count), range(len(rows))):
                row = rows[row_number]
                if (row["leg"], row["station"]) != mount:
                    continue
                value_mm = float(row["value_mm"]) + scatter[cycle, row_number]
                place = [row[name] for name in COLUMNS]
                writer.writerow([*place, f"{value_mm:.4f}", cycle + int(row["cycle"])])
    command = ["-m", "app", "import", str(table), "-o", str(session)]
    subprocess.run([sys.executable, *command], capture_output=True, check=True, cwd=ROOT)
    return session
