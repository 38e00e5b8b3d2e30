"""Errors of procedures, machine files and records; the tree stands in calib/errors.py."""

from __future__ import annotations

from calib.errors import GlidecalError


class RecordError(GlidecalError):
    """A file or record that cannot be used."""


class UsageError(GlidecalError):
    """A name or option that does not exist or does not fit."""
