"""The face of glidecal: commands, screens, texts, exports, sessions under way.

The only place that knows typer, rich and Textual. May import protocols, drivers and calib; its own
rooms stand in layers, which import-linter holds.
"""
