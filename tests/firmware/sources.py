"""Firmware of boards, compiled from its own sources with the simulator that its authors wrote.

Nothing of it is kept in this repository and nothing is fetched: the sources lie in the folder that
GLIDECAL_FIRMWARE names, or in ``firmware`` beside the repository, as checkouts or bare git
directories. Both firmwares believe to run on a board; `board.c` is what is connected to it.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import tarfile
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import pytest

from tests.conftest import ROOT

HERE = Path(__file__).parent
FOLDER = "GLIDECAL_FIRMWARE"
SOURCES = {"grbl": ("grbl", "grbl-sim"), "grblHAL": ("grblHAL-core", "grblHAL-Simulator")}
"""The firmware, and the simulator that it is compiled into."""

TOOLS = {"grbl": ("gcc", "make"), "grblHAL": ("gcc", "make", "cmake")}
COMPILE_S = 300

CLOCK_HZ = 4_000_000
"""A quarter of an Uno's: its simulator counts every tick and must keep pace with real time."""

SIMULATED_HAL_HZ = 16_000_000
WRAPPED = {
    "grbl": (
        "grbl_per_tick",
        "st_prep_buffer",
        "interrupt_SERIAL_UDRE",
        "sim_serial_out",
        "system_set_exec_state_flag",
        "system_clear_exec_state_flag",
    ),
    "grblHAL": ("grbl_per_tick", "st_prep_buffer", "mcu_gpio_set", "sched_yield"),
}
"""Where `board.c` stands between firmware and simulator."""


def folder_of_sources() -> Path:
    """Where the sources would lie."""
    folder = os.environ.get(FOLDER)
    return Path(folder) if folder else ROOT.parent / "firmware"


def need_firmware(firmware: str) -> None:
    """Skip where it cannot be compiled."""
    folder = folder_of_sources()
    missing = [name for name in SOURCES[firmware] if not (folder / name).is_dir()]
    if missing:
        pytest.skip(
            f"no sources of {firmware}: put a checkout or bare git directory of "
            f"{' and of '.join(missing)} into {folder}, or into the folder that {FOLDER} names "
            "(gnea/grbl as grbl, grbl/grbl-sim, grblHAL/core and grblHAL/Simulator)"
        )
    absent = [tool for tool in TOOLS[firmware] if shutil.which(tool) is None]
    if absent:
        pytest.skip(f"needs {', '.join(absent)} to compile {firmware}")


def _copied(name: str, to: Path) -> Path:
    source = folder_of_sources() / name
    if not (source / "HEAD").is_file():
        shutil.copytree(source, to, ignore=shutil.ignore_patterns(".git"), dirs_exist_ok=True)
        return to
    packed = subprocess.run(
        ["git", f"--git-dir={source}", "archive", "HEAD"], check=True, capture_output=True
    )
    with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
        archive.extractall(to, filter="data")
    return to


def _done(folder: Path, *command: str) -> None:
    ended = subprocess.run(
        command, cwd=folder, check=False, capture_output=True, text=True, timeout=COMPILE_S
    )
    assert ended.returncode == 0, ended.stdout[-2000:] + ended.stderr[-2000:]


@cache
def compiled(firmware: str) -> Path:
    """The program of a simulated board, made once a process."""
    need_firmware(firmware)
    return {"grbl": _grbl, "grblHAL": _grblhal}[firmware](Path(mkdtemp(prefix="glidecal-board-")))


def _board(folder: Path, *options: str) -> str:
    _done(folder, "gcc", "-O2", "-Wall", *options, "-c", str(HERE / "board.c"), "-o", "board.o")
    return str(folder / "board.o")


def _wrapping(firmware: str) -> str:
    return ",".join(("-Wl", *(f"--wrap={name}" for name in WRAPPED[firmware])))


def _grbl(folder: Path) -> Path:
    """Version 1.1, for a machine whose coordinates count upwards from its switches."""
    firmware, simulator = SOURCES["grbl"]
    shutil.copytree(_copied(firmware, folder / "all") / "grbl", folder / "grbl")
    build = _copied(simulator, folder / "grbl" / "grbl-sim")
    board = _board(build, "-I.", "-DPLAT_LINUX", f"-DF_CPU={CLOCK_HZ}")
    options = "FLAGS=-O2 -fcommon -w -DHOMING_FORCE_SET_ORIGIN"
    libraries = f"LINUX_LIBRARIES=-lrt -pthread {board} {_wrapping('grbl')}"
    clock = f"CLOCK={CLOCK_HZ}"
    # two threads share its buffer: a compiler that puts stores in another order garbles lines
    _done(build, "make", "../serial.o", clock, options.replace("-O2", "-O0"))
    _done(build, "make", "main", clock, options, libraries)
    return build / "grbl_sim.exe"


def _grblhal(folder: Path) -> Path:
    firmware, simulator = SOURCES["grblHAL"]
    root = _copied(simulator, folder / "simulator")
    _copied(firmware, root / "src" / "grbl")
    build = root / "build"
    build.mkdir()
    places = ("-I../src", "-I../src/grbl")
    board = _board(build, "-DGRBL_HAL", "-DPLATFORM_LINUX", f"-DF_CPU={SIMULATED_HAL_HZ}", *places)
    linked = f"-DCMAKE_EXE_LINKER_FLAGS={board} {_wrapping('grblHAL')}"
    no_trial = "-DCMAKE_TRY_COMPILE_TARGET_TYPE=STATIC_LIBRARY"  # it has no simulator to link with
    _done(build, "cmake", "..", linked, no_trial)
    _done(build, "make", "-j2", "grblHAL_sim")
    return build / "grblHAL_sim"
