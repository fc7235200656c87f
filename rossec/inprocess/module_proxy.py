"""A module as rospy sees it, with some of its names replaced."""

from types import ModuleType
from typing import Any


class ModuleProxy:
    """Stands for a module; some of its names mean something else."""

    def __init__(self, module: ModuleType, **replaced: object) -> None:
        self._module = module
        self.__dict__.update(replaced)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)
