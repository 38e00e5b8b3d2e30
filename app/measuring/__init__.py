"""A session under way: indicators, steps, the record, playback, the simulated machine.

Screens and commands drive what stands here. May import `app.evaluating`, protocols, drivers, calib.
"""
