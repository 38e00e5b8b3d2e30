"""Verbs, together where they share options: parse, call, print. Heavy imports stand in functions.

May import every room of app.
"""
