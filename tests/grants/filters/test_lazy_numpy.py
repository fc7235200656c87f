import subprocess
import sys

import numpy

from grants.filters.lazy_numpy import np


def test_names_are_those_of_numpy_and_kept() -> None:
    assert np.floor is numpy.floor
    assert "floor" in vars(np)


def test_numpy_is_imported_only_when_it_is_needed() -> None:
    code = (
        "import sys, grants.guard; assert 'numpy' not in sys.modules\n"
        "from grants.filters.lazy_numpy import np; np.dtype; assert 'numpy' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
