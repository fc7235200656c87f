"""Which of a domain's masters a command on its host is about: `ROSSEC_MASTER`, or `/master`."""

from collections.abc import Mapping
from typing import Final

from ca.names import MASTER, is_master_name
from rossec.errors import ConfigurationError

__all__ = ["MASTER", "own_master", "own_master_of"]
VARIABLE: Final = "ROSSEC_MASTER"


def own_master(name: str) -> str:
    """Return `name` if it is that of a master.

    Raises:
        ConfigurationError: it is not.
    """
    if not is_master_name(name):
        raise ConfigurationError(
            f"{name[:255]!a} is not the name of a master", "/master, or /master/kitchen"
        )
    return name


def own_master_of(variables: Mapping[str, str]) -> str:
    """The name in the environment; `/master` by default.

    Raises:
        ConfigurationError: it is not that of a master.
    """
    return own_master(variables.get(VARIABLE) or MASTER)
