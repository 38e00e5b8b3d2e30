"""A printer with three upright towers: its machine file, and where its tool met the plate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np
from pydantic import ValidationError

from calib.arrays import FloatArray
from calib.errors import RecordError
from calib.tripod.geometry import FURTHEST_DEG, USUAL_ANGLES_DEG, trilaterate
from protocols.documents import Triple, describe, triple
from protocols.machine import Drive, Machine
from protocols.procedure import USUAL_PRINTABLE_MM
from protocols.table import MeasuredDistance

OFF_PLATE_MM = 5.0
"""So far the tool may be above or below its plate in a contact: a machine that is off by more was
not printing, and its contacts are of another geometry."""

NEAR_REACH = 0.97
"""Of a bar's length across, beyond which it is too level to place a tool by."""

LEAST_APART_DEG = 30.0
"""Between two towers: nearer ones do not place a tool."""

CLEAR_MM = 10.0
"""A carriage may go lower than any contact needs by so much."""

LARGEST = 10_000.0
"""Of lengths in mm, and of angles."""

Pair = tuple[float, float]


@dataclass(frozen=True)
class Contact:
    """The tool at ``place_mm``, ``height_mm`` over a plate: measured by a probe, or by hand.

    ``text`` is what the file says; ``resolution_mm`` the step in which places are known.
    """

    place_mm: Triple
    text: str
    height_mm: float = 0.0
    resolution_mm: float | None = None
    by: Literal["probe", "hand"] = "probe"


@dataclass(frozen=True)
class FileContent:
    """What the files of a printer hold: its geometry if they have it, contacts, and odd lines.

    ``distances`` are those between marks of a printed object. ``beside_mm`` is where the probe is
    from the tool, in x and y.
    ``oddities`` names what looked like geometry or a contact and is not used, with the reason.
    """

    printer: TowerPrinter | None
    contacts: tuple[Contact, ...]
    oddities: tuple[str, ...] = ()
    distances: tuple[MeasuredDistance, ...] = ()
    beside_mm: Pair = (0.0, 0.0)


@dataclass(frozen=True)
class TowerPrinter:
    """Geometry as firmware has it, tower by tower, mm and degrees from x anticlockwise.

    ``endstop_mm`` are heights of the tool over the middle of the plate at which the switches trip:
    the carriage is then at that height plus sqrt(length^2 - radius^2). ``printable_mm`` is the
    radius that the firmware allows, ``turn_mm`` the travel for one turn of a motor,
    ``rotation_distance_mm`` and ``steps_per_mm`` what is held for the travel of each tower; None:
    not known. ``thing`` is what error messages name.
    """

    thing: str
    name: str
    length_mm: Triple
    radius_mm: Triple
    endstop_mm: Triple
    angle_deg: Triple = USUAL_ANGLES_DEG
    printable_mm: float | None = None
    turn_mm: float | None = None
    rotation_distance_mm: Triple | None = None
    steps_per_mm: Triple | None = None

    def __post_init__(self) -> None:
        values = (*self.length_mm, *self.radius_mm, *self.endstop_mm, *self.angle_deg)
        for value in (*values, self.printable_mm or 0.0, self.turn_mm or 0.0):
            if not abs(value) <= LARGEST:
                raise RecordError(
                    self.thing, f"{value:g}", f"lengths in mm and angles, up to {LARGEST:g}"
                )
        for length, radius in zip(self.length_mm, self.radius_mm, strict=True):
            if not 0.0 < radius < NEAR_REACH * length:
                raise RecordError(
                    self.thing,
                    f"bars of {length:g} mm on a radius of {radius:g} mm",
                    f"a radius above 0 and below {NEAR_REACH:g} of the bars' length",
                    "Are these bars and a radius, in mm?",
                )
        gaps_deg = [(a - b + 180.0) % 360.0 - 180.0 for a, b in combinations(self.angle_deg, 2)]
        if min(map(abs, gaps_deg)) < LEAST_APART_DEG:
            raise RecordError(
                self.thing,
                f"towers at {', '.join(f'{angle:g}' for angle in self.angle_deg)}°",
                f"three towers around the plate, {LEAST_APART_DEG:g}° or more between two of them",
                "Two towers at one place do not hold a tool. Look at the angles.",
            )

    @cached_property
    def towers_mm(self) -> FloatArray:
        """Where each tower stands ``(3, 3)``, at height 0."""
        angle, radius = np.radians(self.angle_deg), np.array(self.radius_mm)
        return np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(3)], axis=1)

    @cached_property
    def _raised_mm(self) -> FloatArray:
        """Height of each carriage ``(3,)`` over the tool in the middle."""
        return np.asarray(np.sqrt(np.square(self.length_mm) - np.square(self.radius_mm)))

    @property
    def switches_mm(self) -> FloatArray:
        """Height of each carriage ``(3,)`` where its switch trips."""
        return np.array(self.endstop_mm) + self._raised_mm

    def tool_mm(self, carriage_mm: FloatArray) -> Triple:
        """Where the tool is with carriages at these heights ``(3,)``.

        Raises UnreachablePosture where the bars do not meet.
        """
        feet = self.towers_mm + np.asarray(carriage_mm)[:, None] * np.array([0.0, 0.0, 1.0])
        # the towers stand anticlockwise, as their angles do: then the tool is below this plane
        first, second = feet[1] - feet[0], feet[2] - feet[0]
        side = -1.0 if np.cross(first, second)[2] > 0.0 else 1.0
        return triple(trilaterate(feet, np.array(self.length_mm), side).tolist())

    @property
    def reach_mm(self) -> float:
        """The radius that is printed on: as stated, but no more than towers and bars allow."""
        radius = max(self.radius_mm)
        most_mm = min(radius, min(self.length_mm) - radius)
        return min(self.printable_mm or most_mm, most_mm)

    @property
    def joints(self) -> tuple[Literal["x"], Literal["y"], Literal["z"]] | None:
        """Drives of the firmware's towers, where their angles do not tell which is which."""
        places = zip(self.angle_deg, USUAL_ANGLES_DEG, strict=True)
        gaps_deg = [abs((angle - usual + 180.0) % 360.0 - 180.0) for angle, usual in places]
        return ("x", "y", "z") if max(gaps_deg) > FURTHEST_DEG else None

    @property
    def stated_reach_mm(self) -> float | None:
        """The reach where the firmware states it, or where the usual plate is beyond it."""
        is_beyond = self.reach_mm < USUAL_PRINTABLE_MM
        return self.reach_mm if self.printable_mm is not None or is_beyond else None

    def machine(self, contacts: Sequence[Contact], beside_mm: Pair = (0.0, 0.0)) -> Machine:
        """The machine file, with travel for the printable plate and these contacts.

        The probe is ``beside_mm`` the tool. Raises RecordError.
        """
        is_beside = any(beside_mm)
        lengths = np.array(self.length_mm)
        half = float(round(0.5 * self.reach_mm))
        corners = np.array([[a * half, b * half, 0.0] for a in (-1, 1) for b in (-1, 1)])
        over_corners = self._over_mm(corners)
        edge = [
            (self.reach_mm * math.cos(angle), self.reach_mm * math.sin(angle), 0.0)
            for angle in np.radians(np.arange(0.0, 360.0, 30.0)).tolist()
        ]
        places = np.array([*corners, *edge, *(contact.place_mm for contact in contacts)])
        lowest = self._over_mm(places) + places[:, 2:] - self._raised_mm
        top = float(math.floor((self.switches_mm - over_corners).min() - 1.0))
        equal_bars = len(set(self.length_mm)) == 1
        try:
            return Machine(
                name=self.name,
                leg_length_mm=self.length_mm[0] if equal_bars else float(lengths.mean()),
                travel_max_mm=float(math.ceil(max(self.endstop_mm))),
                travel_min_mm=float(math.floor(min(lowest.min(), 0.0) - CLEAR_MM)),
                workspace_mm=((-half, -half, 0.0), (half, half, max(top, 1.0))),
                set_at_zero=True,
                procedure="plate-rings",
                offset_tolerance_mm=1.0,
                length_tolerance_mm=0.4,
                # cut with one jig: an askew plate leaves 0.039 mm with 0, 0.024 with 0.7, and 0.017
                # with 0.8, where unlike bars cost more, 0.030 instead of 0.022
                length_correlation=0.7,
                across_tolerance_mm=0.4,
                radius_tolerance_mm=5.0,
                lean_tolerance_mrad=1.0,
                scale_tolerance_mm_m=1.0,
                plate_bow_tolerance_mm=0.05,
                platform_tilt_tolerance_mrad=1.0 if is_beside else 0.0,
                probe_offset_mm=beside_mm if is_beside else None,
                printable_radius_mm=self.stated_reach_mm,
                position_endstop_mm=self.endstop_mm,
                joints=self.joints,
                rotation_distance_mm=self.rotation_distance_mm,
                steps_per_mm=self.steps_per_mm,
                screw_lead_mm=self.turn_mm,
                # an upright tower: only its distance from the platform's joint acts, and that is
                # at the tool
                drive=triple(
                    Drive(
                        origin_mm=(round(x, 6) + 0.0, round(y, 6) + 0.0, 0.0),
                        direction=(0.0, 0.0, 1.0),
                        leg_length_mm=None if equal_bars else length,
                    )
                    for (x, y, _), length in zip(
                        self.towers_mm.tolist(), self.length_mm, strict=True
                    )
                ),
            )
        except ValidationError as problem:
            raise RecordError(
                self.thing,
                reason=describe(problem),
                allowed="the geometry of a printer with three upright towers",
            ) from problem

    def _over_mm(self, places_mm: FloatArray) -> FloatArray:
        """Height of carriages over the tool at places ``(n, 3)``: ``(n, 3)``."""
        across = places_mm[:, None, :2] - self.towers_mm[:, :2]
        lengths = np.array(self.length_mm)
        square = (across**2).sum(axis=-1)
        return np.asarray(np.sqrt(lengths**2 - np.minimum(square, (NEAR_REACH * lengths) ** 2)))
