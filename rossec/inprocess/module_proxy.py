"""A module in which some names are replaced, for rospy."""

from types import ModuleType
from typing import Any


class ModuleProxy:
    """Behaves as a module; some of its names are replaced."""

    def __init__(self, module: ModuleType, **replaced: object) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)
