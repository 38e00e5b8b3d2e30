"""One file a verb: parse, call, print. Heavy imports stand inside the functions.

May import every room of app.
"""
