"""What to measure next, and which postures show most.

Asks the machines; the choice itself is mathematics of `calib.design`. May import
`app.measuring`, `app.evaluating`, protocols, calib.
"""
