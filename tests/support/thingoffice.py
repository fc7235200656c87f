"""An authority with two border routers, and orders about things."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from ca.keys import private_keys
from ca.keys.signing import KeySigner
from ca.revocation.lists import open_list
from ca.svid import build_request
from ca.things import ThingKey
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService, SignedThing, ThingOrder
from rossec.home import NodeHome
from tests.support.pki import NOW, new_signer

PASSPHRASE: Final = "four random words here"
LAMP, BORDER, ATTIC = "/things/lamp", "/border", "/attic"
DAY: Final = 86_400


class Office:
    """An authority below `root`, whose border routers have their directories in the same home."""

    def __init__(self, root: Path) -> None:
        self.root, self.now = root, NOW
        self.home = AuthorityHome.create(root, "home", PASSPHRASE, NOW)
        self.service = AuthorityService(root, lambda: PASSPHRASE, lambda _: None, lambda: self.now)
        for name in (BORDER, ATTIC):
            self.enroll(name)
        self.order = ThingOrder(LAMP, BORDER, self.key(b"\x2b"), DAY)

    def key(self, kid: bytes) -> ThingKey:
        """The credential of a new thing."""
        return ThingKey.of(new_signer().public_key, kid)

    def enroll(self, name: str, replaced: str | None = None) -> NodeHome:
        """Give a node of this home a key and an identity."""
        node = NodeHome.of(self.root, name)
        if replaced is not None:
            node.path.rename(node.path.with_name(f"former{len(list(node.path.parent.iterdir()))}"))
        node.create_request("home")
        bundle = self.service.identities.issue(
            node.request(), 30 * DAY, replace_key=replaced, wildcard=False, source="file"
        )
        node.install(bundle, self.now)
        return node

    def sign(self, **changes: Any) -> SignedThing:
        """State what the lamp is, with some changes."""
        return self.service.things.sign(replace(self.order, **changes))

    def request(self, name: str = LAMP) -> bytes:
        """A request with a new key, as another border router makes it."""
        return build_request(KeySigner(private_keys.generate()), "home", name)

    def thumbprint(self, name: str) -> bytes:
        """The newest valid key of a node."""
        return self.service.unlock().store.valid_certificate(name, self.now).thumbprint

    def revoked(self) -> frozenset[bytes]:
        """What the newest signed list has."""
        return open_list(self.home.revocation_list(), self.home.anchor().public_key).entries
