"""Tests of results of files."""
