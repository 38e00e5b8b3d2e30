"""One file to read, print and sign: HTML, or the same as PDF. Needs the extra ``report``.

A report is sections of sentences, tables and figures; one template shows any of them. May import
what `app.report.text` and `app.report.charts` may.
"""
