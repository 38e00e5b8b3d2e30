"""The Hexa Slide: six sliders on fixed rails, six links, one platform with six freedoms.

Its simulation, planning, calibration and diagnosis. May import every room of `calib`, and nothing
of another machine: model selection of `calib.posterior`, thresholds of `calib.diagnosis`.
"""
