"""numpy is imported on first use; the import must not count as a slow example."""

import numpy as np

np.zeros(1)
