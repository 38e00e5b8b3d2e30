"""Sentences and tables that people read; commands and screens share them.

May import what `app.report` may.
"""
