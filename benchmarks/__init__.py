"""Figures of speed, as ratios in one run: ``make bench``."""

from app import screens  # before Textual: it sets how often pictures may come

__all__ = ["screens"]
