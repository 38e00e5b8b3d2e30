"""A LinuxCNC INI file, read as the controller reads it, quirks included.

A section is found by the beginning of a line, a second one of the same name is not looked at, the
first entry of a key counts, and includes are put in place one level deep.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable, Iterator
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from app.report.offsets import MINUTE
from calib.arrays import LEG_NAMES
from calib.errors import RecordError
from calib.tripod.controller import ControllerJoint, ControllerJoints
from protocols.data_table import NUMBER
from protocols.documents import LARGEST_MM, read_text

INCLUDE = "#INCLUDE"
MM_OF_UNIT = {"mm": 1.0, "metric": 1.0, "in": 25.4, "inch": 25.4, "imperial": 25.4}
FARTHEST = 1e99
"""What the controller takes for a limit that is none."""

YES = ("yes", "true", "1", "on")


def read_controller(path: Path) -> ControllerJoints:
    """The joints of a LinuxCNC INI file. Raises RecordError where the controller would not start.

    A joint without HOME_OFFSET has 0. Lengths are converted where the machine is in inches.
    """
    ini = Entries(path)
    mm_per_unit = _unit(ini)
    count = int(ini.number("KINS", "JOINTS", least=1.0, default=float(len(LEG_NAMES))))
    if count < len(LEG_NAMES):
        raise RecordError(f"INI file {path}, [KINS] JOINTS", str(count), "three joints or more")
    joints = tuple(_joint(ini, f"JOINT_{n}", mm_per_unit) for n in range(count))
    # which joint moves which axis, where the kinematics are told
    kinematics = ini.find("KINS", "KINEMATICS") or ""
    coordinates = re.search(r"\bcoordinates=([a-zA-Z]+)", kinematics)
    return ControllerJoints(
        joints,
        mm_per_unit,
        axes=coordinates[1].upper() if coordinates else None,
        entered=max(ini.recorded(), default=None),
        source=f"INI file {path}",
        kinematics=next(iter(kinematics.split()), ""),
        coordinates="".join((ini.find("TRAJ", "COORDINATES") or "").upper().split()),
    )


def _unit(ini: Entries) -> float:
    text = ini.find("TRAJ", "LINEAR_UNITS")
    if text is not None and text.lower() in MM_OF_UNIT:
        return MM_OF_UNIT[text.lower()]
    if text is not None and NUMBER.fullmatch(text) and 1e-6 < float(text) < 1e6:
        return 1.0 / float(text)  # the controller counts units a millimetre
    raise RecordError(
        f"INI file {ini.path}, [TRAJ] LINEAR_UNITS",
        repr(text) if text else "nothing",
        ", ".join(MM_OF_UNIT) + ", or units in a mm as a number",
    )


def _joint(ini: Entries, section: str, mm_per_unit: float) -> ControllerJoint:
    if not ini.has(section):
        raise RecordError(f"INI file {ini.path}", f"no section [{section}]", f"one for {section}")
    home = ini.number(section, "HOME_OFFSET") * mm_per_unit
    if abs(home) > LARGEST_MM:
        raise RecordError(
            f"INI file {ini.path}, [{section}] HOME_OFFSET",
            f"{home:g} mm",
            f"at most {LARGEST_MM:g} mm",
        )
    latch = ini.number(section, "HOME_LATCH_VEL")
    search = ini.number(section, "HOME_SEARCH_VEL")
    low, high = (_limit_mm(ini, section, key, mm_per_unit) for key in ("MIN_LIMIT", "MAX_LIMIT"))
    return ControllerJoint(
        home_offset_mm=home,
        latch_sign=(latch > 0) - (latch < 0),
        absolute_encoder=ini.number(section, "HOME_ABSOLUTE_ENCODER") != 0.0,
        backlash_mm=ini.number(section, "BACKLASH") * mm_per_unit,
        compensated=ini.find(section, "COMP_FILE") is not None,
        min_limit_mm=low,
        max_limit_mm=high,
        home_mm=ini.number(section, "HOME") * mm_per_unit,
        search_sign=(search > 0) - (search < 0),
        indexed=(ini.find(section, "HOME_USE_INDEX") or "").lower() in YES,
    )


def _limit_mm(ini: Entries, section: str, key: str, mm_per_unit: float) -> float | None:
    """A limit of a joint; None where it is not stated, or farther away than any machine is long."""
    if ini.find(section, key) is None:
        return None
    limit_mm = ini.number(section, key, least=-FARTHEST, most=FARTHEST) * mm_per_unit
    return limit_mm if abs(limit_mm) <= LARGEST_MM else None


class Entries:
    """Entries of an INI file. Raises RecordError where it cannot be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lines = list(_with_includes(path))

    def has(self, section: str) -> bool:
        """Whether there is such a section."""
        return any(_bare(line).startswith(f"[{section}]") for line in self._lines)

    def recorded(self) -> Iterator[datetime]:
        """When the records began whose offsets stand in includes of this program."""
        comments = " ".join(line.lstrip("# ") for line in self._lines if line.startswith("# "))
        # as `made` of offsets has it
        moment = r"(?:measured|imported) (\d{4}-\d\d-\d\d \d\d:\d\d [+-]\d{4})"
        for match in re.finditer(moment, comments):
            with suppress(ValueError):
                yield datetime.strptime(match[1], MINUTE)

    def find(self, section: str, key: str) -> str | None:
        """The first entry of the first section of this name; None where there is none."""
        lines = iter(self._lines)
        for line in lines:
            if _bare(line).startswith(f"[{section}]"):
                break
        for line in _joined(lines):  # only entries go on in the next line, not headings
            bare = _bare(line)
            if bare.startswith("["):
                return None
            if entry := re.match(rf"{re.escape(key)}(?:[ \t][^=]*)?=\s*(.*)", bare):
                return entry[1].rstrip()
        return None

    def number(
        self,
        section: str,
        key: str,
        *,
        least: float = -1e9,
        most: float = 1e9,
        default: float = 0.0,
    ) -> float:
        """A number with nothing behind it, which is what the controller accepts."""
        text = self.find(section, key)
        if text is None:
            return default
        if not NUMBER.fullmatch(text) or not least <= float(text) <= most:
            raise RecordError(
                f"INI file {self.path}, [{section}] {key}",
                repr(text) if text else "nothing",
                "a number with a decimal point and no comment behind it",
            )
        return float(text)


def _with_includes(path: Path) -> Iterator[str]:
    """Lines with those of included files in place; an include in an include is a comment.

    The start script looks at all only if one of them begins a line, and reads the rest of that
    line as a shell reads words.
    """
    lines = read_text(path, "INI file").splitlines()
    expanded = any(line.startswith(INCLUDE) for line in lines)
    for line in lines:
        first, _, target = line.strip().partition(" ")
        if expanded and first == INCLUDE and target:
            included = path.parent / _file_name(path, target)
            if included.exists():  # the controller complains, and starts without it
                yield from read_text(included, "INI file").splitlines()
        else:
            yield line


def _file_name(path: Path, text: str) -> str:
    try:
        name = " ".join(shlex.split(text, comments=True))
    except ValueError as problem:
        raise RecordError(
            f"INI file {path}, {INCLUDE}", repr(text), "the name of a file"
        ) from problem
    return os.path.expandvars(Path(name).expanduser())


def _joined(lines: Iterable[str]) -> Iterator[str]:
    """Lines that end with a backslash go on in the next one, and are nothing without one."""
    line_start = ""
    for line in lines:
        if line.endswith("\\"):
            line_start += line[:-1]
            continue
        yield line_start + line
        line_start = ""


def _bare(line: str) -> str:
    """The line from its first letter; nothing of a comment."""
    bare = line.lstrip(" \t\r")
    return "" if bare[:1] in ("#", ";") else bare
