"""A site for tests: a real authority, real certificates, grants and revocation lists."""

import itertools
import secrets
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from ca.authority import Authority, create_root
from ca.certificates import Identity, TrustAnchor
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import RevocationList, sign_list
from ca.revocation.trust_status import Revocations
from ca.svid import build_request
from grants.document import grant_id, sign
from grants.model import Draft, Permission, Right
from grants.renewal import Delegation, sign_delegation
from rossec.channel.edhoc.credentials import Credentials

DAY = 86400


@dataclass(frozen=True)
class EnrolledNode:
    """An enrolled node."""

    identity: Identity
    credentials: Credentials
    signer: KeySigner

    @property
    def name(self) -> str:
        return self.identity.name

    @property
    def thumbprint(self) -> bytes:
        return self.identity.thumbprint


@dataclass
class Site:
    """One trust domain."""

    now: int = field(default_factory=lambda: int(time.time()))
    domain: str = "home"

    def __post_init__(self) -> None:
        self.signer = KeySigner(generate())
        root = create_root(self.signer, self.domain, now=self.now, serial=secrets.randbits(127))
        self.authority = Authority(self.signer, root)
        self.anchor = TrustAnchor.load(root)
        self._numbers = itertools.count(1)

    def enroll(self, name: str, *, wildcard: bool = False) -> EnrolledNode:
        return self.certify(name, KeySigner(generate()), wildcard=wildcard)

    def certify(self, name: str, signer: KeySigner, *, wildcard: bool = False) -> EnrolledNode:
        """Certify a key that there is."""
        request = build_request(signer, self.domain, name)
        certificate = self.authority.issue(
            request, now=self.now, serial=secrets.randbits(127), wildcard=wildcard
        )
        identity = self.anchor.verify([certificate], self.now)
        return EnrolledNode(identity, Credentials(signer, (certificate,)), signer)

    def grant(
        self,
        to: EnrolledNode,
        rights: Mapping[str, Right],
        *,
        lifetime: int = DAY,
        start: int = 0,
        cap: int = 0,
    ) -> bytes:
        begin = self.now + start
        draft = Draft(
            domain=self.domain,
            subject=to.name,
            holder=to.thumbprint,
            not_before=begin,
            expires=begin + lifetime,
            cap=begin + max(lifetime, cap),
            serial=secrets.token_bytes(16),
            permissions=tuple(Permission(name, right) for name, right in rights.items()),
        )
        return sign(self.signer, draft)

    def delegation(
        self, to: EnrolledNode, *, lifetime: int = DAY, start: int = -60, domain: str = ""
    ) -> bytes:
        """Let `to`, the master, renew grants for an hour at a time."""
        begin = self.now + start
        draft = Delegation(
            domain or self.domain, to.thumbprint, begin, begin + lifetime, 3600, secrets.token_bytes(16)
        )
        return sign_delegation(self.signer, draft)

    def revoke(self, *entries: bytes | EnrolledNode, lifetime: int = DAY) -> bytes:
        """The next list; entries are signed grants, ids, or nodes."""
        ids = (
            entry.thumbprint
            if isinstance(entry, EnrolledNode)
            else entry
            if len(entry) in {16, 32}
            else grant_id(entry)
            for entry in entries
        )
        return sign_list(
            self.signer, RevocationList(1, next(self._numbers), self.now, self.now + lifetime, frozenset(ids))
        )

    def revocations(self) -> Revocations:
        """A state that knows the authority and no list."""
        return Revocations(self.anchor.public_key)
