"""What is measured in which order, and the record of having done it.

Machines, procedures, sessions and models as files. May import pydantic and calib; no port, no
screen.
"""
