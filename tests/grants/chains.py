"""Chains for tests: a grant to A, narrowed by A for B, by B for C, by C for D."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from cryptography.hazmat.primitives.asymmetric import ec

from ca.keys.signing import KeySigner, thumbprint
from grants import document, token
from grants.model import Draft, Grant, Permission, Right
from grants.token import sign_narrowing
from tests.grants.authority import CA, NOW, draft

HOLDERS = tuple(KeySigner(ec.generate_private_key(ec.SECP256R1())) for _ in range(4))
A, B, C, D = HOLDERS
NAMES = ("/remote/hospital/a", "/b", "/c", "/d")
EVERYTHING = Permission("/**", Right(255))


def key_of(signer: KeySigner) -> bytes:
    """The thumbprint of a signer's key."""
    return thumbprint(signer.public_key)


@dataclass(frozen=True)
class Made:
    """A token, and what it says."""

    token: bytes
    grant: Grant

    def narrowed(self, by: KeySigner, *permissions: Permission, **changes: Any) -> "Made":
        """Another narrowing after this one, by default for the next of the holders."""
        made = following(self.grant, *permissions, **changes)
        data = sign_narrowing(by, made, self.grant)
        packed = token.pack_chain(self.token, [data])
        return Made(packed, token.peek(packed))

    @property
    def narrowings(self) -> tuple[bytes, ...]:
        return token.unpack(self.token).narrowings


def first(*permissions: Permission, holder: KeySigner = A, **changes: Any) -> Made:
    """A grant to A that may be narrowed three times."""
    wanted: dict[str, Any] = {
        "holder": key_of(holder),
        "subject": NAMES[0],
        "may_narrow": 3,
        "cap": NOW + 100,
    } | changes
    data = document.sign(CA, draft(*(permissions or (EVERYTHING,)), **wanted))
    return Made(data, token.peek(data))


def following(parent: Grant, *permissions: Permission, **changes: Any) -> Draft:
    """The draft of a narrowing after `parent`, for the next holder."""
    depth = len(parent.links)
    wanted: dict[str, Any] = {
        "holder": key_of(HOLDERS[depth]),
        "subject": NAMES[depth],
        "serial": bytes([depth]) * 16,
        "may_narrow": parent.may_narrow - 1,
    } | changes
    base = draft(*(permissions or (EVERYTHING,)), domain=parent.domain)
    end = wanted.setdefault("expires", base.expires)
    return replace(base, **wanted, cap=end)


def chain_of(links: Sequence[Permission | tuple[Permission, ...]]) -> Made:
    """A chain whose links permit this, in order."""
    made = first(*_tuple(links[0]))
    for by, permissions in zip(HOLDERS, links[1:], strict=False):
        made = made.narrowed(by, *_tuple(permissions))
    return made


def _tuple(permissions: Permission | tuple[Permission, ...]) -> tuple[Permission, ...]:
    return permissions if isinstance(permissions, tuple) else (permissions,)
