"""Textual screens: they show and ask; every number comes from elsewhere."""

import os

# Read when Textual loads: a reading that just missed a picture waits half as long for the next.
os.environ.setdefault("TEXTUAL_FPS", "120")
