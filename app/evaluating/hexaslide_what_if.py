"""What a cause of some size would do to a session of postures: which there are to try."""

from __future__ import annotations

from dataclasses import dataclass

from app.evaluating.hexaslide_calibration import beside_effects, models_without_mistakes
from calib.hexaslide.causes import OF_READINGS
from calib.hexaslide.diagnosis import WeighedCauses
from calib.hexaslide.what_if import PostureTrial
from protocols.hexaslide import HexaSlideMeasurements


@dataclass(frozen=True, eq=False)
class CausesToTry:
    """Causes of a machine, the likeliest first, with the weight of all models that have them."""

    source: HexaSlideMeasurements
    models: WeighedCauses
    likely: dict[tuple[str, str], float]

    def trial(self, name: tuple[str, str]) -> PostureTrial:
        """The trial of one cause. Raises CalibrationError."""
        return PostureTrial.of(self.models, name, self.source.machine.whole())


def causes_to_try(source: HexaSlideMeasurements) -> CausesToTry:
    """Beside the parameters; postures that are named as mistakes are left out.

    Raises CalibrationError where that cannot be told.
    """
    models = models_without_mistakes(source, beside_effects(source, source.readings(), ()))
    likely = models.likely()
    names = [(cause.id, cause.where) for cause in models.causes if cause.id not in OF_READINGS]
    ordered = sorted(names, key=lambda name: (-likely.get(name, 0.0), name))
    return CausesToTry(source, models, {name: likely.get(name, 0.0) for name in ordered})
