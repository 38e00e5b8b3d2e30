"""Tests of what a person is asked."""
