"""Scripts that make pages and pictures of docs/, typed and tested like everything else."""

import os

THREADS = os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
"""As the program does, before numpy is imported: small matrices are slower on several cores."""
