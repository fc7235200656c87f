"""What the parts of one node share: its name, its rights, and its connections to others."""

import contextlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

from ca.certificates import Identity
from ca.names import shown
from grants.guard import MemoryScope
from rossec.errors import AnswerRefused
from rossec.net.aio import SecureStream
from rossec.participant.access import Access
from rossec.participant.authorized import AuthorizedConnection
from rossec.participant.connections import ConnectionTable, Dialer
from rossec.participant.handshakes import caller_for
from rossec.participant.renewals import MasterCall

_log = logging.getLogger("rossec.node")

GuardT = TypeVar("GuardT")
NodeConnection: TypeAlias = AuthorizedConnection[SecureStream[Identity], GuardT]


@dataclass
class NodeContext:
    """The context of one running node."""

    name: str
    access: Access
    connections: ConnectionTable[SecureStream[Identity]]
    call: MasterCall  # calls the master
    dialer: Dialer
    filter_key: Callable[[str], bytes]  # finds a key for pseudonyms by its name
    memory_scope: MemoryScope  # finds what a limited right has used up
    uri: str = ""  # of its API, as registered; empty until it listens
    rosrpc: str = ""  # the URI of its services, as registered
    certified: str = ""  # its name without an anonymous suffix; empty: it has none

    def name_for(self, peer: Identity) -> str:
        return caller_for(peer, self.name, self.certified or self.name)

    @contextlib.contextmanager
    def restoring(self, what: str) -> Iterator[None]:
        """Register `what` again; a refusal of one registration must not prevent the others."""
        try:
            yield
        except AnswerRefused as error:
            _log.warning("%s: %s is not registered again: %s", self.name, shown(what), error)
