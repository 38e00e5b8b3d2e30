"""What a person is asked, and what an answer leads to; no screen.

A conversation asks a `person.Person` and calls; screens are one. May import every room of app below
commands, machines, screens and serving.
"""
