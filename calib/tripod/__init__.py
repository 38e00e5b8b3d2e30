"""The Orthoglide: three orthogonal linear drives, three bars, one tool that never turns."""
