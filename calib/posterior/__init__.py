"""One posterior over parameters, effects, laws without a name and something else.

May import all of `calib` but `calib.diagnosis`.
"""
