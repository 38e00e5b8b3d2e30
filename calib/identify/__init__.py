"""From readings to joint offsets and leg lengths, and how far to trust them.

Knows noise, design and the machine.
"""
