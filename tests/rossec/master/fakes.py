"""Callers with chosen rights, and an authority that never was, for the tests of the cores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from grants.errors import GrantError
from grants.model import Right
from rossec.master.api import Presented
from rossec.master.gatekeeper import Caller, Peer

ALL = Right(255)


@dataclass
class FakeAccess:
    """Rights by exact name, by `/ns/**`, or `**` for everything."""

    rights: Mapping[str, Right] = field(default_factory=dict)

    def require(self, right: Right, name: str) -> None:
        if not self.covers(right, name):
            raise GrantError("no grant covers it", "ask the authority for one")

    def covers(self, right: Right, name: str) -> bool:
        for pattern, rights in self.rights.items():
            prefix = pattern.removesuffix("**")
            covered = name == pattern or (prefix != pattern and name.startswith(prefix))
            if covered and right in rights:
                return True
        return False

    def covers_any(self, rights: Right, name: str) -> bool:
        return any(self.covers(right, name) for right in Right if right in rights)


def caller(name: str, rights: Mapping[str, Right] | None = None) -> Caller:
    return Caller(name, name.encode(), FakeAccess(rights or {}))


def everything(name: str) -> Caller:
    return caller(name, {"**": ALL})


def anonymous(name: str, rights: Mapping[str, Right] | None = None) -> Caller:
    """With a wildcard tail."""
    return Caller(name, name.encode(), FakeAccess(rights or {"**": ALL}), wildcard=True)


@dataclass
class FakeStatements:
    """What the trust module is to the API."""

    callers: dict[str, Caller] = field(default_factory=dict)
    lists: list[bytes] = field(default_factory=list)
    presented: list[bytes] = field(default_factory=list)

    def caller_of(self, peer: Peer, now: int) -> Caller | None:
        known = self.callers.get(peer.name)
        return known if known is not None and known.thumbprint == peer.thumbprint else None

    def present(self, caller: Caller, tokens: Sequence[bytes], now: int) -> Presented:
        good = [token for token in tokens if token != b"forged"]
        self.presented += good
        return Presented(len(self.presented), ("forged",) * (len(tokens) - len(good)))

    def current(self, now: int) -> tuple[bytes, bytes]:
        return (self.lists[-1], b"stamp") if self.lists else (b"", b"")

    def update(self, data: bytes, now: int) -> bool:
        if data == b"forged":
            raise GrantError("the signature is not the authority's")
        newer = not self.lists or data > self.lists[-1]
        if newer:
            self.lists.append(data)
        return newer
