"""A diagnosis beside reading its file alone, and as a whole process: time and peak memory."""

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
WITHIN = """
import gc, statistics, sys, time
from pathlib import Path
from app.evaluating.diagnosis import diagnose_files
from glidecal.__main__ import NEW_OBJECTS
from protocols.record import read_record

def spent_s(work, path):
    start = time.process_time()
    work(path)
    return time.process_time() - start

gc.set_threshold(NEW_OBJECTS)
sample, session = map(Path, sys.argv[1:3])
diagnose_files([sample])  # imports, and what a process works out once
for work in (read_record, lambda path: diagnose_files([path])):
    print(statistics.median(spent_s(work, session) for _ in range(int(sys.argv[3]))))
"""
"""Reads a file again and again, then diagnoses it, in one process."""
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


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
    command = [sys.executable, "-c", code, sys.executable, *arguments]
    process = subprocess.run(
        command, capture_output=True, check=True, cwd=ROOT, env=os.environ | ONE_THREAD, text=True
    )
    return Cost(*json.loads(process.stdout))


def _within(session: Path) -> list[float]:
    """Medians of reading the file and of its diagnosis in one process, s."""
    command = [sys.executable, "-c", WITHIN, str(SAMPLE), str(session), str(ROUNDS)]
    process = subprocess.run(
        command, capture_output=True, check=True, cwd=ROOT, env=os.environ | ONE_THREAD, text=True
    )
    return [float(line) for line in process.stdout.split()]


def diagnosis() -> list[str]:
    """Sessions of a sweep, of more and more readings."""
    lines = [
        "| readings | reading the file, s | diagnosis, s | more, s | whole process, s "
        "| peak memory, MB |",
        "|---|---|---|---|---|---|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        for cycles in CYCLES:
            session = _session(Path(folder), cycles)
            read_s, diagnosis_s = _within(session)
            whole = cost("-m", "app", "diagnose", str(session), "--json")
            count = len(fold(read_record(session).events).readings)
            lines.append(
                f"| {count} | {read_s:.2f} | {diagnosis_s:.2f} | {diagnosis_s - read_s:.2f} "
                f"| {whole.processor_s:.2f} | {whole.peak_mb:.0f} |"
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
