"""Tests of what measurements see."""
