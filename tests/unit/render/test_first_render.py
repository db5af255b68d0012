"""A process's first rendering has the bits of its second: SciPy's linear algebra is limited to one thread before it is used."""

import subprocess
import sys

SCRIPT = """
import sys
import clsim
from clsim.numerics.blas import with_blas_threads

assert "scipy.linalg" not in sys.modules
with with_blas_threads(1):
    from threadpoolctl import threadpool_info

    import numpy, scipy.linalg
    found = [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]
    print(found)
    assert found and set(found) == {1}
"""


def test_all_linear_algebra_has_one_thread_from_the_first_use_on() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)
