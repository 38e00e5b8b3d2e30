"""What a set of measurements can see, and which set sees most: any machine, any measurement.

Knows arrays only, no machine.
"""
