"""What tests of files of motion share."""

import pytest
from motion_rows import motion


@pytest.fixture
def rows():
    t, x, q = motion()
    return [list(map(float, (t[i] + 1000.0, *x[i], *q[i]))) for i in range(len(t))]


@pytest.fixture
def euroc_rows(rows):
    return [[1403715524907143168 + 100_000_000 * i, *row[1:4], row[7], *row[4:7], 0.0] for i, row in enumerate(rows)]
