"""What a border router knows of each thing that is authenticated now. Pure.

A thing has one conversation. A new one ends the former, as a thing that was restarted has forgotten
it. At most `CAPACITY` are held, and the one that was quiet for longest makes room; whoever is not
authenticated has none.
"""

from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Final

from rossec.border.contexts import OscoreContext
from rossec.border.quotas import Quota
from rossec.border.transmissions import Address

CAPACITY: Final = 1024
REMEMBERED: Final = 4  # answers to the last requests of a thing, in case they are repeated


class Conversation:
    """One thing: its context, where it is, what it may send.

    Args:
        mid: the message ID before the first; random, or whoever sees no datagram of this thing
            could still end its requests by forged resets (RFC 7252 section 11.4).

    Attributes:
        name: of the thing.
        tokens: of requests that it has not answered, and of observations.
    """

    __slots__ = ("_answers", "_mid", "address", "context", "name", "quota", "seen", "tokens")

    def __init__(self, name: str, context: OscoreContext, address: Address, mid: int = 0) -> None:
        self._mid = mid
        self.name: Final = name
        self.context: Final = context
        self.address = address
        self.quota: Final = Quota()
        self.tokens: set[bytes] = set()
        self.seen = 0.0
        self._answers: deque[tuple[Address, int, bytes]] | None = None

    @property
    def kid(self) -> bytes:
        """How it names its context."""
        kid: bytes = self.context.recipient_id
        return kid

    def new_mid(self) -> int:
        """A message ID that this thing was not sent for long (RFC 7252 section 4.4)."""
        self._mid = (self._mid + 1) & 0xFFFF
        return self._mid

    def remember(self, address: Address, mid: int, answer: bytes) -> None:
        """Keep an answer: a request that is repeated is not carried out again."""
        if self._answers is None:
            self._answers = deque(maxlen=REMEMBERED)
        self._answers.append((address, mid, answer))

    def remembered(self, address: Address, mid: int) -> bytes | None:
        """The answer to a request that is repeated."""
        for source, number, answer in self._answers or ():
            if source == address and number == mid:
                return answer
        return None


class Conversations:
    """Those of all things.

    Args:
        ended: called with a conversation that is over.
    """

    def __init__(self, ended: Callable[[Conversation], None]) -> None:
        self._ended = ended
        self._by_name: OrderedDict[str, Conversation] = OrderedDict()
        self._by_kid: dict[bytes, Conversation] = {}
        self._by_address: dict[Address, Conversation] = {}

    def __len__(self) -> int:
        return len(self._by_name)

    def all(self) -> list[Conversation]:
        """All of them."""
        return list(self._by_name.values())

    def find(self, kid: bytes) -> Conversation | None:
        """The one whose thing uses this ID."""
        return self._by_kid.get(kid)

    def of(self, name: str) -> Conversation | None:
        """That of a thing."""
        return self._by_name.get(name)

    def at(self, address: Address) -> Conversation | None:
        """That of the authenticated thing that was there last."""
        return self._by_address.get(address)

    def add(self, conversation: Conversation) -> None:
        """Begin one, and end what it replaces: of this thing, or of what it was called before."""
        self.drop(conversation.name)
        if (former := self._by_kid.get(conversation.kid)) is not None:
            self.drop(former.name)
        if len(self._by_name) >= CAPACITY:
            self.drop(next(iter(self._by_name)))
        self._by_name[conversation.name] = conversation
        self._by_kid[conversation.kid] = conversation
        self._by_address[conversation.address] = conversation

    def used(self, conversation: Conversation, address: Address) -> None:
        """It is the most recent now, and there."""
        self._by_name.move_to_end(conversation.name)
        if conversation.address != address:
            self._leave(conversation)
            conversation.address = address
            self._by_address[address] = conversation

    def _leave(self, conversation: Conversation) -> None:
        if self._by_address.get(conversation.address) is conversation:
            del self._by_address[conversation.address]

    def drop(self, name: str) -> None:
        """End that of a thing, if there is one."""
        found = self._by_name.pop(name, None)
        if found is not None:
            del self._by_kid[found.kid]
            self._leave(found)
            self._ended(found)
