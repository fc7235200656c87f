"""numpy, imported when the first array is treated: a process that filters none need not load it.

It takes a third of a sidecar's memory. Attributes are looked up once and cached.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeAlias

__all__ = ["Vector", "np"]


class _LazyNumpy:
    """Imports numpy on the first access to an attribute."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(import_module("numpy"), name)
        setattr(self, name, found)
        return found


if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Vector: TypeAlias = npt.NDArray[Any]
else:
    np = _LazyNumpy()
    Vector = Any
