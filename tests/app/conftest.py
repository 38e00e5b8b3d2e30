"""Habits of the tests of the program's face."""

from tests.posteriors import same_readings_same_posterior

__all__ = ["same_readings_same_posterior"]
