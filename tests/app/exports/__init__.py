"""Tests of files for controllers."""
