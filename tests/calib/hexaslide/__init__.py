"""Tests of the Hexa Slide."""
