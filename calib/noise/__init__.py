"""How much a reading scatters: repeats, the display's step, indicators.

Knows observations and distributions, no machine.
"""
