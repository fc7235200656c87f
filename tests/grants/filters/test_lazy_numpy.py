import subprocess
import sys

import numpy

from grants.filters.coarsening import np


def test_attributes_are_those_of_numpy_and_cached() -> None:
    assert np.floor is numpy.floor
    assert "floor" in vars(np)


def test_numpy_is_imported_on_first_use() -> None:
    code = (
        "import sys, grants.guard; assert 'numpy' not in sys.modules\n"
        "from grants.filters.coarsening import np; np.dtype; assert 'numpy' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
