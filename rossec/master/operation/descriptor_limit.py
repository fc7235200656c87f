"""The limit on open files: each node takes two, and a shell's soft limit is often 1024."""

import resource
from typing import Final

DESCRIPTORS: Final = 65536


def raise_descriptor_limit() -> None:
    """Raise the soft limit to `DESCRIPTORS`, or to the hard limit where that is lower."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    missing = DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < missing:
        resource.setrlimit(resource.RLIMIT_NOFILE, (missing, hard))
