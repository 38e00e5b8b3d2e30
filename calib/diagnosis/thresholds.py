"""From which probabilities on a verdict says what, for every kind of machine."""

MISSING = 0.9
"""Probability that anything is missing, from which on the verdict says so: of 114 blind sessions
that hide nothing none came beyond 0.78."""

SURE = 0.95
"""Probability of a claim that is made without a rival, or that names do not explain everything."""

OPEN = 0.01
"""Claims that lack a name and have together so little weight of what is missing are no rivals: the
truth is to be in the set 99 times of 100."""

AGREED = 0.6
"""Probability that nothing is missing, from which on readings agree: before any it is 0.45."""

EVEN = 0.5
"""Probability from which on the simpler is told: nothing is missing, nothing acts beside a name."""
