"""Three linear drives, three bars, a platform that never turns: Orthoglide and linear delta.

May import `calib.design` and `calib.noise`, and nothing of another machine.
"""

UPRIGHT_TOWERS = "delta"
"""What firmware calls the kinematics of three of them."""
