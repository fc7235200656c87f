"""A running master of a home, which has listed a hospital; nodes of the hospital that visit it."""

from contextlib import AsyncExitStack
from itertools import count
from typing import Any, Final

from ca.domains import DomainList, ForeignDomain, sign_domains
from ca.keys.signing import to_coordinates
from ca.revocation.lists import Timestamp, digest, open_list, sign_timestamp
from grants.model import Right
from rossec.net.rpc.calls import RpcClient
from tests.rossec.master.world import SlaveNode, World
from tests.support.authority import DAY, EnrolledNode, Site

HOSPITAL: Final = "hospital.example"
LABEL: Final = "hospital"


class Hospital:
    """Another trust domain, and its master's word on what it revoked."""

    def __init__(self, domain: str = HOSPITAL) -> None:
        self.site = Site(domain=domain)
        self.master = self.site.enroll("/master")

    def entry(self, label: str = LABEL, **changes: Any) -> ForeignDomain:
        """An entry of a list for all of its nodes, fresh for an hour, for a day."""
        fields: dict[str, Any] = {
            "admitted": ("/**",),
            "fresh": 3600,
            "until": self.site.now + DAY,
            **changes,
        }
        return ForeignDomain(self.site.domain, label, self.site.anchor.certificate, **fields)

    def word(self, *revoked: bytes | EnrolledNode, age: int = 0) -> tuple[bytes, bytes, tuple[bytes, ...]]:
        """Its next list, a timestamp of it, and the chain of its master."""
        data = self.site.revoke(*revoked)
        seq = open_list(data, self.site.anchor.public_key).seq
        stamp = Timestamp(seq, digest(data), self.site.now - age, 30)
        signed = sign_timestamp(self.master.credentials.signer, stamp)
        return data, signed, self.master.credentials.chain


class Lists:
    """The lists of domains of a home, in order."""

    def __init__(self, home: Site) -> None:
        self._home = home
        self._numbers = count(1)

    def next(self, *entries: ForeignDomain, masters: tuple[EnrolledNode, ...] = ()) -> bytes:
        """The next list."""
        keys = sorted(to_coordinates(each.identity.public_key) for each in masters)
        found = tuple(sorted(entries, key=lambda each: each.domain))
        now = self._home.now
        listed = DomainList(1, next(self._numbers), now, now + DAY, found, tuple(keys))
        return sign_domains(self._home.signer, listed, self._home.domain)


class VisitWorld(World):
    """A home whose master lists the hospital and knows its revocations."""

    def __init__(self, exit_stack: AsyncExitStack) -> None:
        super().__init__(exit_stack)
        self.hospital = Hospital()
        self.lists = Lists(self.site)
        self.trust.update_domains(self.lists.next(self.hospital.entry()))
        self.trust.domains.take(HOSPITAL, *self.hospital.word(), self.site.now)
        self.robot = self.hospital.site.enroll("/rounds/robot3")

    async def visitor(self, rights: dict[str, Right], member: EnrolledNode | None = None) -> SlaveNode:
        """A node of the hospital with grants of the home."""
        node = SlaveNode(self, member or self.robot)
        await node.start(rights)
        return node

    async def connect(self, member: EnrolledNode) -> RpcClient:
        """A connection to the master, over which it has answered."""
        client = await self.call_as(member)
        await client.ask("getPid", member.name)
        return client

    def take(self, *revoked: bytes | EnrolledNode, age: int = 0) -> None:
        """The hospital's next list and its master's word on it."""
        self.server.effects.take_foreign(HOSPITAL, *self.hospital.word(*revoked, age=age))
