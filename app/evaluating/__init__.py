"""From session files to a solution, a diagnosis, a comparison, an adopted model.

Frozen results go in and out; nothing is shown or asked here. May import protocols and calib.
"""
