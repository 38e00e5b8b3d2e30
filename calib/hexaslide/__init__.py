"""The Hexa Slide: six sliders on fixed rails, six links, one platform with six freedoms.

Its simulation, planning, calibration and diagnosis. May import every room of `calib`, and nothing
of another machine: of `calib.posterior` the race of models, of `calib.diagnosis` its thresholds.
"""
