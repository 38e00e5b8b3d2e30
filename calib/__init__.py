"""Mathematics of calibration on arrays; no file, no port, no screen.

May import numpy, scipy and joblib, and nothing of the other three rooms.
"""
