"""The Hexa Slide: six sliders on fixed rails, six links, one platform with six freedoms.

May import `calib.design` and `calib.noise`, and nothing of another machine.
"""
