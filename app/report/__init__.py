"""What people and programs are told: text, charts, JSON.

Results go in, sentences and documents come out; nothing is computed that they do not hold.
May import every room of app below commands, screens and exports.
"""
