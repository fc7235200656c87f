"""numpy is imported when it is first needed; that must not count as a slow example."""

import numpy as np

np.zeros(1)
