"""What a machine may have beyond offsets and lengths: laws, and where they may act.

May import what `calib.tripod` may, its geometry and pipeline first of all.
"""

from calib.tripod.effects.catalogue import CATALOGUE

__all__ = ["CATALOGUE"]
