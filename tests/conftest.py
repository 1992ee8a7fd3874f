"""Small matrices on two cores: BLAS threads cost more than they bring. Must be set before NumPy is imported."""

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
