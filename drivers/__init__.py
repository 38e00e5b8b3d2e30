"""Bytes: ports, indicators and their simulated twins. Knows pyserial, no screen and no file."""
