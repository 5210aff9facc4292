"""The radar's domain, and the messages between its processes."""

import os

# One thread per process for linear algebra: matrices are small, processes are many, and a run's digest must not
# depend on how many cores a reduction was split over. Read by the libraries when NumPy is first imported.
for _variable in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_variable] = "1"
