"""What to measure next, and which postures show most.

Reads files and options and calls; what is computed is mathematics of `calib`. May import
`app.measuring`, `app.evaluating`, protocols, calib.
"""
