"""What trust in other domains costs: a foreign handshake beside an own one, a chain beside a grant.

Pure: both ends of a handshake are in this process and no socket is. Both variants of a ratio take
turns, and the minimum of each is taken. Certificates are verified in full each time.
"""

import secrets
import time
from dataclasses import dataclass
from functools import partial

from bench.grants import shortest_us
from ca.authority import Authority, create_root
from ca.domains import Anchors, DomainList, ForeignDomain, sign_domains
from ca.keys import private_keys
from ca.keys.signing import KeySigner, thumbprint
from ca.svid import build_request
from grants.document import sign
from grants.model import Draft, Permission, Right
from grants.token import Verifier, pack_chain, peek, sign_narrowing
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.edhoc.handshake import EdhocConfig
from tests.support.wire import receive

DAY = 86400
LISTED = 16  # foreign domains that the server trusts


@dataclass(frozen=True)
class Domain:
    """An authority, and whom it trusts."""

    authority: Authority
    anchors: Anchors

    @classmethod
    def create(cls, name: str, now: int) -> "Domain":
        key = _signer()
        root = create_root(key, name, now=now, serial=secrets.randbits(127) + 1)
        authority = Authority(key, root)
        return cls(authority, Anchors(authority.anchor))

    def enroll(self, name: str, now: int) -> Credentials:
        key = _signer()
        request = build_request(key, self.authority.anchor.domain, name)
        serial = secrets.randbits(127) + 1
        return Credentials(key, (self.authority.issue(request, now=now, serial=serial),))

    def trust(self, others: "list[Domain]", now: int) -> None:
        """Sign and take a list of these domains."""
        anchors = sorted((each.authority.anchor for each in others), key=lambda one: one.domain)
        listed = tuple(
            ForeignDomain(one.domain, one.domain, one.certificate, ("/**",), 3600, now + DAY)
            for one in anchors
        )
        domains = DomainList(0, 1, now, now + DAY, listed)
        signer = self.authority.signer
        self.anchors.update(sign_domains(signer, domains, self.authority.anchor.domain))


def handshakes(seconds: float) -> dict[str, float]:
    """The time of a handshake, both ends together, with a foreign client and an own one."""
    now = int(time.time())
    home = Domain.create("home", now)
    others = [Domain.create(f"site{number}", now) for number in range(LISTED)]
    home.trust(others, now)
    others[-1].trust([home], now)
    server = home.enroll("/robot", now)

    def handshake(client: Credentials, anchors: Anchors) -> None:
        left = Connection.initiator(EdhocConfig(client, anchors.verify, secrets.token_bytes), now=now)
        right = Connection.responder(EdhocConfig(server, home.anchors.verify, secrets.token_bytes), now=now)
        events = 0
        while data := left.data_to_send():
            events += len(receive(right, bytes(data), now))
            events += len(receive(left, bytes(right.data_to_send()), now))
        assert events == 2, "both ends know their peer"

    own, foreign = home.enroll("/viewer", now), others[-1].enroll("/viewer", now)
    times = shortest_us(
        seconds, lambda: handshake(own, home.anchors), lambda: handshake(foreign, others[-1].anchors)
    )
    return {
        "own_handshake_us": round(times[0], 1),
        "foreign_handshake_us": round(times[1], 1),
        "foreign_handshake_vs_own": round(times[1] / times[0], 3),
    }


def chains(seconds: float) -> dict[str, float]:
    """The time to verify a token: a grant, one narrowed twice (three links), the longest chain."""
    now = int(time.time())
    authority, holders = _signer(), [_signer() for _ in range(4)]
    drafts = [_draft(holder, 3 - depth, now) for depth, holder in enumerate(holders)]
    grant = sign(authority, drafts[0])
    tokens, parent = [grant], peek(grant)
    for holder, draft in zip(holders, drafts[1:], strict=False):
        tokens.append(pack_chain(tokens[-1], [sign_narrowing(holder, draft, parent)]))
        parent = peek(tokens[-1])
    verifier = Verifier(authority.public_key, "home", (), 0, _nothing_is_revoked)
    one, _, three, longest = tokens
    times = shortest_us(seconds, *(partial(verifier.open, token, now) for token in (one, three, longest)))
    return {
        "verify_grant_us": round(times[0], 1),
        "verify_chain3_vs_grant": round(times[1] / times[0], 2),
        "verify_longest_vs_grant": round(times[2] / times[0], 2),
    }


def _signer() -> KeySigner:
    return KeySigner(private_keys.generate())


def _draft(holder: KeySigner, may_narrow: int, now: int) -> Draft:
    return Draft(
        domain="home",
        subject="/remote/hospital/rounds/robot3",
        holder=thumbprint(holder.public_key),
        not_before=now - 60,
        expires=now + DAY,
        cap=now + DAY,
        serial=secrets.token_bytes(16),
        permissions=(Permission("/robot/pose", Right.SUBSCRIBE),),
        may_narrow=may_narrow,
    )


def _nothing_is_revoked(_entry: bytes, _now: int) -> None:
    """As the check of a revocation list that is empty."""
