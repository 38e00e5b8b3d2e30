"""How much a reading scatters: repeats, how they follow each other, the display's step, indicators.

Knows observations and distributions, no machine.
"""
