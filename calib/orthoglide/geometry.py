"""Nominal geometry of an Orthoglide: what the controller believes."""

from __future__ import annotations

from dataclasses import dataclass

from calib.errors import CalibrationError

PARAMETER_NAMES = ("d_rho_x", "d_rho_y", "d_rho_z", "d_L_x", "d_L_y", "d_L_z")
"""The base parameters: joint offsets, then leg length errors; both in mm."""

TOLERANCE_MM = 5.0
"""No machine is put together so badly: an error of this size would be seen without measuring."""


@dataclass(frozen=True)
class Geometry:
    """Nominal dimensions in mm; the defaults are the prototype of papers/000, section 2.1.

    ``travel_max_mm`` and ``travel_min_mm`` are the joint limits about the Zero posture and at the
    same time the displacements of the postures Max and Min. ``gravity`` is the unit vector of the
    pull of weight, ``screw_lead_mm`` the travel of a carriage for one turn, None if not known.
    ``load`` is the weight carried now, in units of the usual one.
    """

    leg_length_mm: float = 310.25
    travel_max_mm: float = 60.0
    travel_min_mm: float = -100.0
    parallelogram_width_mm: float = 80.0
    tool_radius_mm: float = 31.0
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    screw_lead_mm: float | None = None
    load: float = 1.0

    def __post_init__(self) -> None:
        for name in ("leg_length_mm", "parallelogram_width_mm", "tool_radius_mm"):
            if not getattr(self, name) > 0:
                raise CalibrationError(name, f"{getattr(self, name):g}", "a positive length in mm")
        if not -self.leg_length_mm < self.travel_min_mm < 0 < self.travel_max_mm:
            raise CalibrationError(
                "joint limits",
                f"{self.travel_min_mm:g} … {self.travel_max_mm:g} mm",
                "travel_min_mm < 0 < travel_max_mm, both shorter than the leg",
            )
        if not self.travel_max_mm < self.leg_length_mm:
            raise CalibrationError(
                "travel_max_mm",
                f"{self.travel_max_mm:g}",
                f"less than the leg length {self.leg_length_mm:g} mm",
            )
