"""Textual screens: they show and ask; every number comes from elsewhere."""

import os

# Read when Textual loads: a reading that just missed a picture waits half as long for the next.
# From a value shown to the terminal, p99: 20 ms, 33 with Textual's 60 (medians of three runs each).
os.environ.setdefault("TEXTUAL_FPS", "120")
