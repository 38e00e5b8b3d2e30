"""Where simulation and measurement disagree, what is missing, and how sure that is.

May import every room of `calib` but that of another machine.
"""
