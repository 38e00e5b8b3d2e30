"""Charts and drawings as data: points, strokes, scales, apart from any screen.

May import what `app.report` may.
"""
