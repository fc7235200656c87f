"""What a border router that runs says of its things, in a file of its directory. No secrets.

The file is written every few seconds, so an old one shows that the router does not run.
"""

import json
from pathlib import Path
from typing import Any, Final

from rossec import files
from rossec.border.router import BorderRouter
from rossec.errors import ConfigurationError

FILE: Final = "border.status"
PERIOD: Final = 5.0  # seconds between two of them
OLD: Final = 20  # seconds after which nobody writes it any more
MAX_STATUS: Final = 4 * 1024 * 1024


def describe(router: BorderRouter, now: int) -> dict[str, Any]:
    """The state of a router."""
    endpoint = router.server.endpoint
    host, port = router.server.address
    counts = endpoint.counts
    return {
        "at": now,
        "address": [host, port],
        "counts": {
            "datagrams": counts.datagrams, "refused": counts.refused,
            "over_budget": counts.over_budget, "handshakes": counts.handshakes,
            "derivations": counts.derivations, "lost": router.server.lost,
        },
        "things": {name: _thing(router, name) for name in router.roster.names},
    }  # fmt: skip


def _thing(router: BorderRouter, name: str) -> dict[str, Any]:
    bridge = router.bridges.get(name)
    conversation = router.server.endpoint.conversations.of(name)
    here = {"there": conversation is not None}
    if bridge is None:
        return here
    return {
        **here,
        "offered": bridge.offered,
        "resources": len(bridge.resources),
        "received": bridge.received,
        "refused": bridge.refused,
        "over_rate": 0 if conversation is None else conversation.quota.dropped,
    }  # fmt: skip


def write(directory: Path, status: dict[str, Any]) -> None:
    """Store it. Raises `NotWritten`."""
    files.replace(directory / FILE, json.dumps(status, separators=(",", ":")).encode())


def read(directory: Path, now: int) -> dict[str, Any]:
    """What the router said last.

    Raises:
        ConfigurationError: no router runs there, or the file is not its own.
    """
    idle = ConfigurationError("no border router runs here", "start it: rossec border")
    data = files.read_own(directory / FILE, MAX_STATUS, idle)
    try:
        status = json.loads(data)
        fresh = now - int(status["at"]) <= OLD
    except (ValueError, KeyError, TypeError):
        raise ConfigurationError(f"{directory / FILE} is damaged", "remove it") from None
    if not fresh:
        raise idle
    return dict(status)
