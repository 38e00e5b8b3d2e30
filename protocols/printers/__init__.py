"""Printers with three upright towers as their firmware knows them: machine file and contacts.

A dialect reads texts into a `TowerPrinter` and its `Contact`; `imported` makes a session of them.
"""
