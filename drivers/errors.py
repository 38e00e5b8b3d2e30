"""Errors of ports and indicators; the tree stands in calib/errors.py."""

from __future__ import annotations

from calib.errors import GlidecalError


class IndicatorError(GlidecalError):
    """An indicator or port that cannot be used."""
