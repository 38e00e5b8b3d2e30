"""Speed as ratios in one run, as Markdown and pictures: ``make bench``.

``python -m benchmarks.run [PART ...] [-o docs/benchmarks.md]``. Nothing here is a test: machines
are noisy. Every figure stands beside another one of the same run.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import numpy as np
from scipy.optimize import root

from app.evaluating.history import Entry, Index, key_of, read_history
from benchmarks.controller import controller
from benchmarks.diagnosis import diagnosis
from benchmarks.hexaslide import hexaslide
from benchmarks.identification import table as identification
from benchmarks.interface import interface
from benchmarks.page import (
    Table,
    seconds,
    tables_of,
    with_tables,
    with_versions,
    write_pictures,
)
from benchmarks.postures import postures
from calib.arrays import FloatArray
from calib.identify.identify import IdentificationCase, identify
from calib.identify.solution import Method, Solution
from calib.noise.reading import IndicatorFigures
from calib.tripod.geometry import PARAMETER_NAMES, TOLERANCE_MM, Geometry, direct, inverse
from calib.tripod.pipeline import Model
from drivers.line import IndicatorLine
from drivers.port import open_port
from drivers.profile import Spindle
from drivers.profiles import PROFILES
from drivers.twins import IndicatorTwin, TwinPort, default_transport
from protocols.observations import to_observations
from protocols.record import read_record
from protocols.session import fold

ROOT = Path(__file__).parent.parent
SAMPLE = ROOT / "sample_sessions" / "simulated_zero-max-min.jsonl"
POSTURES = 100_000
ROOT_POSTURES = 500
ASKED = 2000


def direct_kinematics() -> list[str]:
    """Direct kinematics of many postures, beside a general solver in a loop."""
    tool = np.random.default_rng(1).uniform(-100.0, 60.0, (POSTURES, 3))
    geometry = Geometry()
    length_mm = geometry.leg_length_mm[0]
    carriage = inverse(geometry, tool)

    def residual(point: FloatArray, q: FloatArray) -> FloatArray:
        legs = point - np.diag(q)
        return np.asarray((legs * legs).sum(axis=1) - length_mm**2)

    def solver() -> None:
        for q in carriage[:ROOT_POSTURES]:
            root(residual, np.zeros(3), args=(q,))

    closed = POSTURES / seconds(lambda: direct(geometry, carriage))
    loop = ROOT_POSTURES / seconds(solver, 3)
    return [
        "| direct kinematics | postures per second | ratio |",
        "|---|---|---|",
        f"| trilateration, any tripod | {closed / 1e6:.2f} million | {closed / loop:.0f} |",
        f"| scipy.optimize.root in a loop | {loop:.0f} | 1 |",
    ]


def whole_identification() -> list[str]:
    """One standard session from readings to a result with uncertainties and checks."""
    observations = to_observations([fold(read_record(SAMPLE).events)])
    model = Model()
    within_mm = np.full(len(PARAMETER_NAMES), TOLERANCE_MM)

    def identified(method: Method) -> Solution:
        case = IdentificationCase.of(model, observations, IndicatorFigures())
        return identify(case, "both", method, tolerance_mm=within_mm)

    exact = seconds(lambda: identified("exact"), 21)
    linear = seconds(lambda: identified("linear"), 21)
    return [
        "| 60 readings, with noise, uncertainties, what is not seen | ms | ratio |",
        "|---|---|---|",
        f"| exact | {exact * 1e3:.2f} | {exact / linear:.1f} |",
        f"| linear | {linear * 1e3:.2f} | 1 |",
    ]


def indicators() -> list[str]:
    """From the request to the value in the program; the twin answers at once."""
    profile = PROFILES["mitutoyo-01a"]
    twin = IndicatorTwin(profile, Spindle(lambda: 1.234, 0.001))
    with TwinPort(twin, default_transport()) as port:
        bare = open_port(profile, port.url)

        def exchange() -> None:
            bare.write(b"1\r")
            bare.read_until(b"\r")

        plain = sorted(seconds(exchange, 1) for _ in range(ASKED))
        bare.close()
        line = IndicatorLine(profile, port.url, interval_s=0.0)
        line.start()
        times = sorted(seconds(lambda: line.ask().result(), 1) for _ in range(ASKED))
        line.close()
    at = round(0.99 * ASKED)
    return [
        "| request → value | median, ms | p99, ms | ratio of medians |",
        "|---|---|---|---|",
        f"| through the owner thread | {times[ASKED // 2] * 1e3:.3f} | {times[at] * 1e3:.3f} "
        f"| {times[ASKED // 2] / plain[ASKED // 2]:.1f} |",
        f"| bare pyserial | {plain[ASKED // 2] * 1e3:.3f} | {plain[at] * 1e3:.3f} | 1 |",
    ]


def processes() -> list[str]:
    """Whole processes, as a person waits for them."""
    python = seconds(lambda: run("-c", "pass"))
    rows = {
        "glidecal --help": seconds(lambda: run("-m", "app", "--help")),
        "glidecal solve, a file that is not there": seconds(
            lambda: run("-m", "app", "solve", "no.jsonl", status=3)
        ),
        "glidecal solve, a sample": seconds(lambda: run("-m", "app", "solve", str(SAMPLE))),
        "glidecal demo --headless": seconds(demo, 3),
    }
    return [
        "| whole process | s | times an empty Python |",
        "|---|---|---|",
        *(f"| {name} | {delay_s:.3f} | {delay_s / python:.1f} |" for name, delay_s in rows.items()),
        f"| python -c pass | {python:.3f} | 1 |",
    ]


KNOWN_SESSIONS = 1000


def histories() -> list[str]:
    """A folder of sessions that the index knows, each looked up by the digest of its bytes."""
    import tempfile

    content = SAMPLE.read_bytes()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "0.jsonl").write_bytes(content)
        once = seconds(lambda: read_history(folder, index=folder / str(time.time_ns())), 3)
        read_history(folder, index=folder / "known")
        with closing(Index(folder / "known")) as index:
            entry = index.get(key_of(content), Entry)
            assert entry is not None
            for k in range(1, KNOWN_SESSIONS):
                copy = content.replace(b'"text":"', b'"text":"%d' % k, 1)
                (folder / f"{k}.jsonl").write_bytes(copy)
                later = {"began": entry.began + timedelta(days=k)}
                index.put(key_of(copy), entry.model_copy(update=later))
        warm_s = seconds(lambda: read_history(folder, index=folder / "known"), 3)
    return [
        "| history | s | ratio |",
        "|---|---|---|",
        f"| {KNOWN_SESSIONS} sessions that the index knows | {warm_s:.2f} | {warm_s / once:.1f} |",
        f"| one session that it does not know | {once:.2f} | 1 |",
    ]


def run(*arguments: str, status: int = 0) -> None:
    """One Python process that ends so; its output is thrown away."""
    process = subprocess.run(
        [sys.executable, *arguments], capture_output=True, check=False, cwd=ROOT
    )
    assert process.returncode == status, process.stderr.decode()


def demo() -> None:
    """The whole demonstration in a folder that is thrown away."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        run("-m", "app", "demo", "--headless", "--folder", folder)


PARTS: dict[str, Callable[[], list[str]]] = {
    "kinematics": direct_kinematics,
    "identification": identification,
    "whole": whole_identification,
    "indicators": indicators,
    "processes": processes,
    "diagnosis": diagnosis,
    "history": histories,
    "postures": postures,
    "hexaslide": hexaslide,
    "interface": interface,
    "controller": controller,
}


def main() -> None:
    """Print every table; with a page, put tables and pictures there."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"some of {', '.join(PARTS)}")
    parser.add_argument("-o", "--output", type=Path, metavar="PAGE", help="docs/benchmarks.md")
    options = parser.parse_args()
    if strangers := set(options.parts) - set(PARTS):
        parser.error(f"{', '.join(sorted(strangers))}: not among {', '.join(PARTS)}")
    versions = f"Python {platform.python_version()}, numpy {np.__version__}, {platform.machine()}"
    print(versions, end="\n\n", flush=True)
    for part in options.parts or PARTS:
        lines = PARTS[part]()
        print("\n".join(lines), end="\n\n", flush=True)
        if options.output:
            put(options.output, tables_of(lines), versions)


def put(page: Path, tables: list[Table], versions: str) -> None:
    """Replace the tables of the page and draw pictures beside it."""
    text, strangers = with_tables(page.read_text(encoding="utf-8"), tables)
    page.write_text(with_versions(text, versions), encoding="utf-8", newline="\n")
    for name in strangers:
        print(f"not on {page}, put it there by hand: {name}", file=sys.stderr)
    write_pictures(tables, page.parent / "pictures")


if __name__ == "__main__":
    main()
