"""Tests of sessions under way."""
