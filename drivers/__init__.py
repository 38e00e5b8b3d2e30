"""Bytes: ports, indicators and their simulated twins; no screen and no record.

May import pyserial, and of `calib` the errors.
"""
