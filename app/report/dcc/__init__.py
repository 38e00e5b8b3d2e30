"""The digital calibration certificate of PTB (DCC 3.2.1, D-SI 2.1.0), and its signature.

Its numbers are those of the results that the report shows, none is computed here but ratios and
ends of intervals. May import what `app.report.pages` may, but for its figures.
"""
