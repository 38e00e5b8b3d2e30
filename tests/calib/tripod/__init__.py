"""Tests of three linear drives."""
