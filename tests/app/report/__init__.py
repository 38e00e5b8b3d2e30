"""Tests of text, charts, JSON."""
