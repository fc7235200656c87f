"""What the parts of one node share: its name, its rights, and its connections to others."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

from ca.certificates import Identity
from ca.domains.aliases import shown
from grants.memory import MemoryScope
from rossec.errors import AnswerRefused
from rossec.net.aio import SecureStream
from rossec.participant.access import Access
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable
from rossec.participant.dialer import Dialer
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.remote_names import caller_for

_log = logging.getLogger("rossec.node")

GuardT = TypeVar("GuardT")
NodeConnection: TypeAlias = AuthorizedConnection[SecureStream[Identity], GuardT]


@dataclass
class NodeContext:
    """The context of one running node.

    Attributes:
        call: calls the master.
        filter_key: finds a key for pseudonyms by its name.
        memory_scope: finds what a limited right has used up.
        uri: its API URI, as registered; empty until it listens.
        rosrpc: the URI of its services, as registered.
        certified: its name without a tail; empty: it has none.
    """

    name: str
    access: Access
    connections: ConnectionTable[SecureStream[Identity]]
    call: MasterCall
    dialer: Dialer
    filter_key: Callable[[str], bytes]
    memory_scope: MemoryScope
    uri: str = ""
    rosrpc: str = ""
    certified: str = ""

    def name_for(self, peer: Identity) -> str:
        """By which name it calls itself to `peer`."""
        return caller_for(peer, self.name, self.certified or self.name)

    @contextlib.contextmanager
    def restoring(self, what: str) -> Iterator[None]:
        """Register `what` again; a refusal of one registration must not prevent the others."""
        try:
            yield
        except AnswerRefused as error:
            _log.warning("%s: %s is not registered again: %s", self.name, shown(what), error)
