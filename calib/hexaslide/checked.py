"""A calibration with its checks: postures kept out of the fit, and the truth where it is known.

How far two machines are apart at the platform is told once frames that no reading shows are laid
over: a Hexa Slide whose platform frame is turned and shifted, or whose base is turned about X, with
all that belongs to it, measures the same where these are not seen. That is no error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from calib.arrays import EXACT_BLIND, FloatArray
from calib.hexaslide.arms import Numbers
from calib.hexaslide.calibration import Calibration, calibrate
from calib.hexaslide.derivatives import STEP
from calib.hexaslide.geometry import (
    LAID_OVER,
    NAMES,
    Geometry,
    HexaSlide,
    forward,
    rotation,
    values,
    with_values,
)
from calib.hexaslide.planning import fewest_postures
from calib.hexaslide.residuals import Readings, Residuals, postures_of, residuals, shares

SPARE = 1.5
"""A fit keeps so many times the fewest postures before any is kept out of it."""

ROUNDS = 6
"""Each squares what is left: from hundredths to rounding."""

TURNS_M = 1e-3
"""Metres that a turn of 1 rad counts like where frames are laid over: places come first, turns
decide only on what moves none."""

PAIRS = tuple(combinations(range(6), 2))


@dataclass(frozen=True, eq=False)
class FramesApart:
    """Constant motions that lay one machine over the other, and what they leave.

    ``turned_rad`` and ``shifted_m`` are those of the platform's frame, ``base_turned_rad`` that of
    the base. ``apart_m`` ``(p, 3)`` and ``angles_rad`` ``(p,)`` are movements and angles left
    between the postures.
    """

    turned_rad: float
    shifted_m: float
    base_turned_rad: float
    apart_m: FloatArray
    angles_rad: FloatArray

    @property
    def places_m(self) -> FloatArray:
        """Distances ``(p,)`` left between the places."""
        return np.asarray(np.linalg.norm(self.apart_m, axis=1))

    @property
    def places_rms_m(self) -> float:
        """Root mean square of the distances."""
        return float(np.sqrt((self.places_m**2).mean()))

    @property
    def places_worst_m(self) -> float:
        """The largest distance."""
        return float(self.places_m.max())

    @property
    def angles_rms_rad(self) -> float:
        """Root mean square of the angles."""
        return float(np.sqrt((self.angles_rad**2).mean()))


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Postures kept out of the fit, by their numbers, and what each machine leaves of them."""

    numbers: tuple[int, ...]
    before: Residuals
    after: Residuals


@dataclass(frozen=True, eq=False)
class AgainstTruth:
    """Nominal and identified machine against the true one, at the same sliders.

    ``kept_out`` tells whether at postures kept out of the fit, else at all. ``misses`` ``(k,)``
    are the errors of the individually known parameters, ``within`` counts those within their 95 %
    interval, None without uncertainties. ``inner_m`` ``(26,)`` are errors of lengths that no frame
    changes.
    """

    kept_out: bool
    before: FramesApart
    after: FramesApart
    misses: FloatArray
    within: int | None
    inner_m: FloatArray


@dataclass(frozen=True, eq=False)
class KnownValues:
    """Values ``(m,)`` with standard uncertainties and half widths of 95 %, None without noise."""

    values: FloatArray
    standard: FloatArray | None
    expanded: FloatArray | None


def parameters_alone(calibration: Calibration) -> KnownValues:
    """Parameters ``(k,)`` by the noise alone; of those that are known together it means nothing."""
    return _by_noise(calibration, np.eye(len(calibration.names)), calibration.parameters)


def lengths_alone(calibration: Calibration) -> KnownValues:
    """`inner_lengths` ``(26,)``, m, by the noise alone; without it where more is open than frames:
    what is left as it was is not known.
    """
    geometry = calibration.machine.geometry
    lengths_m = np.asarray(inner_lengths(geometry))
    if calibration.left_open:
        return KnownValues(lengths_m, None, None)
    slopes = length_slopes(geometry, calibration.names)
    return _by_noise(calibration, slopes, lengths_m)


def _by_noise(calibration: Calibration, slopes: FloatArray, values: FloatArray) -> KnownValues:
    if calibration.covariance is None or calibration.factor is None:
        return KnownValues(values, None, None)
    standard = np.sqrt(((slopes @ calibration.covariance) * slopes).sum(axis=1))
    return KnownValues(values, standard, calibration.factor * standard)


@dataclass(frozen=True, eq=False)
class CheckedCalibration:
    """A calibration with its checks. ``by_column`` and ``by_posture`` share what is left;
    ``numbers`` are the fitted postures.
    """

    start: FloatArray
    fit: Calibration
    fewest: int
    numbers: tuple[int, ...]
    by_column: FloatArray
    by_posture: FloatArray
    held_out: HeldOut | None
    truth: AgainstTruth | None


def checked_calibration(
    readings: Readings, nominal: HexaSlide, true: HexaSlide | None, share: float
) -> CheckedCalibration:
    """Identify from readings, about ``share`` of their postures kept out.

    Raises CalibrationError where the postures give no result.
    """
    fewest = fewest_postures(readings.procedure, nominal)
    out = check_postures(len(readings.sliders), fewest, share)
    fitted, checked, held_out = readings.take(~out), readings, None
    calibrated = calibrate(fitted, nominal, fewest=fewest)
    by_column, by_posture = shares(fitted, calibrated.machine.geometry, calibrated.after)
    if out.any():
        checked = readings.take(out)
        # no machine was fitted to these
        residuals_out = (
            residuals(checked, machine, postures_of(checked, machine))[0]
            for machine in (nominal, calibrated.machine)
        )
        held_out = HeldOut(checked.numbers, *residuals_out)
    return CheckedCalibration(
        start=nominal.parameters(calibrated.names),
        fit=calibrated,
        fewest=fewest,
        numbers=fitted.numbers,
        by_column=by_column,
        by_posture=by_posture,
        held_out=held_out,
        truth=None
        if true is None
        else _against(calibrated, checked, nominal, true, kept_out=held_out is not None),
    )


def check_postures(count: int, fewest: int, share: float) -> NDArray[np.bool_]:
    """Which postures ``(p,)`` stay out of the fit: evenly spread, none where all are needed."""
    most_kept_out = max(count - int(np.ceil(SPARE * fewest)), 0)
    kept_out = min(int(share * count), most_kept_out)
    out = np.zeros(count, dtype=np.bool_)
    # each from the middle of an equal part: those that are fitted reach both ends of the list
    out[[int((k + 0.5) * count / kept_out) for k in range(kept_out)]] = True
    return out


def _against(
    calibration: Calibration,
    readings: Readings,
    nominal: HexaSlide,
    true: HexaSlide,
    *,
    kept_out: bool,
) -> AgainstTruth:
    """Everything that is known better than the measurements tell."""
    sliders = readings.sliders
    stand = [
        np.asarray(forward(machine.geometry, sliders, machine.box))
        for machine in (nominal, calibration.machine, true)
    ]
    numbers = [calibration.names.index(name) for name in calibration.known]
    misses = (calibration.parameters - true.parameters(calibration.names))[numbers]
    expanded = parameters_alone(calibration).expanded
    lengths = inner_lengths(calibration.machine.geometry) - inner_lengths(true.geometry)
    return AgainstTruth(
        kept_out=kept_out,
        before=frames_apart(stand[0], stand[2], calibration.unidentifiable),
        after=frames_apart(stand[1], stand[2], calibration.unidentifiable),
        misses=misses,
        within=None if expanded is None else int((np.abs(misses) <= expanded[numbers]).sum()),
        inner_m=np.asarray(lengths),
    )


def frames_apart(calibrated: FloatArray, true: FloatArray, free: tuple[str, ...]) -> FramesApart:
    """Compare postures ``(p, 6)`` of two machines at the same sliders; ``free`` of `LAID_OVER`."""
    columns = [k for k, name in enumerate(LAID_OVER) if name in free]
    places, turns = calibrated[:, :3], rotation(calibrated[:, 3:])
    true_turns = rotation(true[:, 3:])
    total, weight = np.zeros(len(LAID_OVER)), np.repeat([1.0, TURNS_M], 3)
    for _ in range(ROUNDS if columns else 0):
        miss = np.concatenate([true[:, :3] - places, _vectors(true_turns, turns)], axis=1) * weight
        motions = frame_motions(places, turns)[..., columns] * weight[:, None]
        design = motions.reshape(miss.size, -1)
        change = np.zeros(len(LAID_OVER))
        change[columns] = np.linalg.lstsq(design, miss.ravel(), rcond=EXACT_BLIND)[0]
        base = _about(change[6:9])
        places = (places + turns @ change[3:6]) @ base.T + change[9:]
        turns = base @ turns @ _about(change[:3])
        total += change
    angles = _vectors(true_turns, turns)
    return FramesApart(
        turned_rad=float(np.linalg.norm(total[:3])),
        shifted_m=float(np.linalg.norm(total[3:6])),
        base_turned_rad=float(np.linalg.norm(total[6:9])),
        apart_m=np.asarray(true[:, :3] - places),
        angles_rad=np.asarray(np.linalg.norm(angles, axis=1)),
    )


def frame_motions(places: FloatArray, turns: FloatArray) -> FloatArray:
    """Movement and turn of postures for each of `LAID_OVER` ``(p, 6, 12)``."""
    design = np.zeros((len(places), 6, len(LAID_OVER)))
    design[:, 3:, :3] = turns
    design[:, :3, 3:6] = turns
    design[:, :3, 6:9] = np.cross(np.eye(3), places[:, None, :]).swapaxes(1, 2)
    design[:, 3:, 6:9] = np.eye(3)
    design[:, :3, 9:] = np.eye(3)
    return design


def _vectors(true: FloatArray, turns: FloatArray) -> FloatArray:
    """Rotation vectors ``(p, 3)`` from one orientation to the other."""
    from scipy.spatial.transform import Rotation  # 0.1 s to import: only where used

    return np.asarray(Rotation.from_matrix(true @ np.swapaxes(turns, 1, 2)).as_rotvec())


def _about(vector: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def inner_lengths(geometry: Geometry) -> Numbers:
    """Lengths that no choice of frames changes ``(26,)`` in metres: between the joints of the
    platform (15, in the order of `PAIRS`), from the first rail's start to the other five, six
    links.
    """
    first, second = np.array(PAIRS).T
    apart = geometry.platform[first] - geometry.platform[second]
    between = np.sqrt((apart * apart).sum(axis=1))
    starts = np.sqrt((geometry.base[1:] * geometry.base[1:]).sum(axis=1))
    return np.concatenate([between, starts, geometry.links])


def length_slopes(geometry: Geometry, names: Sequence[str]) -> FloatArray:
    """Derivatives ``(26, k)`` of `inner_lengths` by these parameters, 0 by those of a link."""
    here, order = values(geometry), np.array(NAMES)
    steps = (1j * STEP * (order == name) for name in names)
    slopes = [inner_lengths(with_values(geometry, here + step)).imag / STEP for step in steps]
    return np.stack(slopes, axis=1)
