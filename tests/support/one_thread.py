"""One thread of BLAS for each process of the tests, as in the command line; to be imported before NumPy."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
