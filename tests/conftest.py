"""What holds for every test: BLAS on one thread, and no compiled program that outlives its file."""

import ctypes
import os
import sys

import pytest

# small matrices on two cores: BLAS threads cost more than they bring; must be set before NumPy is imported
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
sys.modules.setdefault("notebook", None)  # jupytext looks for Jupyter's and runs ours
os.environ["CONVEX_SYNTH_CACHE"] = "off"  # nothing of the tests in the user's folder, nothing from it in the tests


@pytest.fixture(scope="module", autouse=True)
def _no_program_outlives_its_file():
    """JAX keeps every program, 1.4 MB for the sum of two arrays: a run of all tests would take gigabytes."""
    yield
    if jax := sys.modules.get("jax"):
        jax.clear_caches()
        if sys.platform == "linux" and hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
            libc.malloc_trim(0)  # glibc would keep the pages, in heaps of threads that need them no more
