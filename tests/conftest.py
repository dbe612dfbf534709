"""One thread for linear algebra, set before anything imports numpy: more only get in each other's way here."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

from hypothesis import settings  # noqa: E402 after the threads

settings.register_profile("untimed", deadline=None)  # a loaded machine is no fault
settings.load_profile("untimed")
