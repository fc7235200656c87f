"""The set-ups by their names, and one of them running."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final, TypeAlias

from bench.thesis.gateways import Gatewayed
from bench.thesis.network import ETHERNET, RADIO, network_of
from bench.thesis.programs import programs
from bench.thesis.setups import HOSTS, ROUTED_HOSTS, Direct, PlainDirect, Relayed

Running: TypeAlias = Direct | Relayed | Gatewayed

SETUPS: Final[Mapping[str, tuple[type[Running], int]]] = {
    "direct_100m": (Direct, ETHERNET),
    "plain_100m": (PlainDirect, ETHERNET),
    "gateway_100m": (Gatewayed, ETHERNET),
    "relay_100m": (Relayed, ETHERNET),
    "direct_300k": (Direct, RADIO),
    "gateway_300k": (Gatewayed, RADIO),
    "relay_300k": (Relayed, RADIO),
}


@contextlib.contextmanager
def setup(name: str, directory: Path) -> Iterator[Running]:
    """A running set-up; its files are in `directory`.

    Raises:
        NoNamespaces: it cannot be made here.
    """
    kind, kbit = SETUPS[name]
    hosts = HOSTS if issubclass(kind, Direct) else ROUTED_HOSTS
    with network_of(hosts) as network, programs(directory) as running:
        made = kind(network, running)
        made.name = name
        made.start(kbit)
        yield made
