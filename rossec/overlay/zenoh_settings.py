"""Settings of Zenoh sessions, as paths of its configuration and JSON values. Pure.

The defaults of Zenoh are for one network of friends: it scouts by multicast, lists and reports
itself, and passes large payloads through /dev/shm, around the network and its limits. What is here
was measured; what for is in section 3.6 of docs/spec/overlay.md. A router that freezes is given up
after the lease; a message that finds no room waits 50 ms, then it is dropped.
"""

import base64
from typing import Final

from rossec.overlay.routers import Routers

LEASE_MS: Final = 2000
_WAIT_US: Final = 50_000
_DROP: Final = "transport/link/tx/queue/congestion_control/drop/"

COMMON: Final[dict[str, object]] = {
    "listen/endpoints": [],
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    "adminspace/enabled": False,
    "timestamping/enabled": False,
    "transport/shared_memory/enabled": False,
    "transport/link/tx/lease": LEASE_MS,
    "transport/unicast/open_timeout": 1000,
    "transport/unicast/accept_timeout": 1000,
    f"{_DROP}wait_before_drop": _WAIT_US,
    f"{_DROP}max_wait_before_drop_fragments": _WAIT_US,
    "connect/retry": {
        "period_init_ms": 200,
        "period_max_ms": 1000,
        "period_increase_factor": 2,
    },
}
"""Of routers and of relays."""


def client_settings(routers: Routers) -> dict[str, object]:
    """Of a relay's session: with one of the routers, another one when that fails.

    It listens nowhere: no port of a site is open for it.
    """
    settings = {
        **COMMON,
        "mode": "client",
        "connect/endpoints": list(routers.locators),
        "connect/timeout_ms": 0,  # each is tried once; who opens the session tries again
        "connect/exit_on_failure": True,
    }
    if routers.password:
        settings["transport/auth/usrpwd/user"] = routers.seat
        settings["transport/auth/usrpwd/password"] = routers.password
    if routers.root_certificate:
        root = base64.b64encode(routers.root_certificate.encode()).decode()
        settings["transport/link/tls/root_ca_certificate_base64"] = root
        settings["transport/link/tls/verify_name_on_connect"] = True
    return settings
