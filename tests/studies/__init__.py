"""Tests of pages of the documentation."""
