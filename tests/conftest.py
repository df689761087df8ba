"""Settings of all tests."""

import scipy.linalg  # noqa: F401  # loads the libraries whose threads are limited below
from threadpoolctl import threadpool_limits

# The matrices of the tests are small: threads of BLAS would only wait for each other.
threadpool_limits(1)
