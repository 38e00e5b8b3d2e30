"""What a machine may have beyond offsets and lengths: laws, and where they may act."""

from calib.tripod.effects.catalogue import CATALOGUE

__all__ = ["CATALOGUE"]
