"""On localhost: whether the program at the other end belongs to this user.

Cookies know no ports, and every user of a host reaches every port of it; so the user of the TCP
peer is looked up for each request. Root is refused like any other user unless the console runs as
root: it could take what it wants anyway, and a browser run as root by mistake should not.
"""

from collections.abc import Mapping
from typing import Any, Final

from rossec.errors import PeerUserRefused
from rossec.net.host import peeruid

_HINT: Final = "open it in a browser of the user who started the console"


def check_peer(scope: Mapping[str, Any], users: frozenset[int] | None) -> None:
    """Return if the connection of a request may be used; `users` None: anybody's may.

    Raises:
        PeerUserRefused: it is of another user, from another host, or nobody knows whose.
    """
    if users is None:
        return
    client, server = scope.get("client"), scope.get("server")
    if not client or not server or server[1] is None:
        raise PeerUserRefused("nobody knows whose connection this is", _HINT)
    try:
        holder = peeruid.find_holder((client[0], client[1]), (server[0], server[1]))
    except OSError as error:
        raise PeerUserRefused("nobody knows whose connection this is", _HINT) from error
    if holder is None or holder.user not in users or not peeruid.is_known(holder.user):
        raise PeerUserRefused("this console belongs to another user of this computer", _HINT)
