"""Settings of all tests."""

import hypothesis
import scipy.linalg  # noqa: F401  # loads the libraries whose threads are limited below
from threadpoolctl import threadpool_limits

# The matrices of the tests are small: threads of BLAS would only wait for each other.
threadpool_limits(1)

# A machine that is busy with something else is no reason to fail.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")
