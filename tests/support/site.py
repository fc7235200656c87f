"""A site for tests: authority, enrolled nodes, grants, and a master, all real, in one process."""

import contextlib
import secrets
import time
from collections.abc import AsyncIterator, Callable, Mapping
from functools import partial
from pathlib import Path

from ca.authority import Authority, create_root
from ca.certificates import Identity, TrustAnchor, to_pem
from ca.keys import private_keys
from ca.keys.signing import KeySigner
from ca.revocation.lists import is_tree, open_tree
from ca.store.record import Store
from grants import document
from grants.model import Draft, Permission, Restriction, Right, filter_rules
from rossec.authority.renewals import renew
from rossec.authority.signing import SigningAuthority, tree_entries
from rossec.channel.opening import post_quantum
from rossec.home import NodeHome
from rossec.master.operation.config import MasterLimits
from rossec.master.server.effects import OnDenial, ignore_denial
from rossec.master.server.server import MasterServer, master_of
from rossec.node import Node
from rossec.ros.names import MASTER, parse_uri

HOUR = 3600
DAY = 86400


class Site:
    """One trust domain below `root`; its authority's key is in memory, unencrypted."""

    def __init__(self, root: Path, domain: str = "home", clock: Callable[[], float] = time.time) -> None:
        self.root = root
        self._clock = clock
        key = KeySigner(private_keys.generate())
        now = self.now()
        certificate = create_root(key, domain, now=now, serial=secrets.randbits(127) + 1)
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        self.authority = SigningAuthority(Authority(key, certificate), Store.create(root / "ca.db"), root)
        self.authority.sign_list(now)
        self.master: MasterServer | None = None
        self.on_denial: OnDenial = ignore_denial
        self.intermediate: SigningAuthority | None = None
        self.host = "127.0.0.1"
        self.limits = MasterLimits()
        self.variables: dict[str, str] = {}  # added to the environment

    def now(self) -> int:
        """Seconds since the epoch, by this site's clock."""
        return int(self._clock())

    @property
    def anchor(self) -> TrustAnchor:
        """The trust anchor of the nodes."""
        return self.authority.authority.anchor

    @property
    def entries(self) -> bytes | None:
        """The entries of the newest tree, if the authority has signed one."""
        data = self.authority.store.newest_list()
        if data is None or not is_tree(data):
            return None
        tree = open_tree(data, self.anchor.public_key)
        return tree_entries(self.authority.store, tree).encoded()

    @property
    def environ(self) -> Mapping[str, str]:
        """The environment a node of this site runs in."""
        uri = {"ROS_MASTER_URI": self.master.uri} if self.master is not None else {}
        return {"ROSSEC_HOME": str(self.root), "ROS_IP": "127.0.0.1", **uri, **self.variables}

    def enroll(self, name: str, lifetime: int = DAY, *, wildcard: bool = False) -> NodeHome:
        """Give the node `name` a key and an identity; with `wildcard`, for anonymous nodes too."""
        home = NodeHome.of(self.root, name)
        if not (home.path / "node.pem").exists():
            home.create_request(self.anchor.domain)
            now = self.now()
            bundle = self.authority.issue(home.request(), now, lifetime, wildcard=wildcard)
            home.install(bundle, now)
        return home

    def renew(self, name: str, lifetime: int = DAY) -> None:
        """Give the node `name` another certificate for the same key."""
        home = self.enroll(name)
        leaf = self.authority.authority.issue(
            home.request(), now=self.now(), serial=secrets.randbits(127) + 1, lifetime=lifetime
        )
        home.install(to_pem(leaf) + (home.path / "ca.pem").read_bytes(), self.now())

    def identity(self, name: str) -> Identity:
        """The verified identity of an enrolled node."""
        return self.enroll(name).identity(self.now())

    def grant(
        self,
        name: str,
        right: Right,
        pattern: str,
        *,
        restriction: Restriction | None = None,
        lifetime: int = DAY,
        cap: int = 0,
        begin: int | None = None,
        holder: bytes | None = None,
    ) -> bytes:
        """Sign a grant for `name` and put it into the node's home; returns the signed grant."""
        home = self.enroll(name)
        now = self.now()
        begin = now - 60 if begin is None else begin
        draft = Draft(
            domain=self.anchor.domain,
            subject=name,
            holder=holder or self.identity(name).thumbprint,
            not_before=begin,
            expires=now + lifetime,
            cap=now + max(lifetime, cap),
            serial=secrets.token_bytes(16),
            permissions=(Permission(pattern, right, restriction),),
        )
        data = self.authority.issue_grant(draft, now)
        home.add_grant(document.grant_id(data), data)
        return data

    def delegate(self, at_most: int = HOUR) -> bytes:
        """Delegate to the master: it renews grants, for `at_most` seconds each."""
        home = self.enroll(MASTER)
        data = self.authority.issue_delegation(self.identity(MASTER).thumbprint, DAY, at_most, self.now())
        home.save_delegation(data)
        return data

    def publish(self, name: str, pattern: str, **options: int) -> bytes:
        """Grant `name` the right to publish."""
        return self.grant(name, Right.PUBLISH, pattern, lifetime=options.get("lifetime", DAY))

    def subscribe(
        self, name: str, pattern: str, restriction: Restriction | None = None, **options: int
    ) -> bytes:
        """Grant `name` the right to subscribe."""
        return self.grant(
            name, Right.SUBSCRIBE, pattern, restriction=restriction, lifetime=options.get("lifetime", DAY)
        )

    def revoke(self, grant_or_key: bytes) -> bytes:
        """Revoke a signed grant, or a key by its thumbprint; returns the new signed list."""
        entry = grant_or_key if len(grant_or_key) == 32 else document.grant_id(grant_or_key)
        self.authority.revoke(entry, "test", self.now())
        data = self.authority.store.newest_list()
        assert data is not None
        return data

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator["Site"]:
        """With a master, on a free port of loopback."""
        await self.start_master(0)
        try:
            yield self
        finally:
            if self.master is not None:
                await self.master.close()
            self.master = None

    async def restart_master(self) -> None:
        """Stop the master and start a new one on the same port."""
        assert self.master is not None
        _, port = parse_uri(self.master.uri)
        await self.master.close()
        await self.start_master(port)

    async def start_master(self, port: int) -> None:
        """Start a master on `port` of `host`."""
        self.master = master_of(
            self.enroll(MASTER),
            host=self.host,
            port=port,
            newest=self.authority.store.newest_list(),
            now=self.now(),
            entries=self.entries,
            on_denial=self.on_denial,
            limits=self.limits,
            renewer=None if self.intermediate is None else partial(renew, self.intermediate),
            suites=post_quantum(self.environ),
        )
        await self.master.start()

    def node(self, name: str, *argv: str) -> Node:
        """A node of this site, not yet started; enrolled by its name, unless a wildcard fits."""
        if not NodeHome.find(self.root, name).is_wildcard():
            self.enroll(name)
        return Node(name, argv=argv, environ=self.environ)


def coarse(step: float = 2.0) -> Restriction:
    """Position on a grid, frame cleared, only for messages in the map frame."""
    return Restriction(
        type="geometry_msgs/PoseStamped",
        conditions=('msg.header.frame_id == "map"',),
        filters=filter_rules(
            {"pose.position": {"round": {"step": step}}, "header.frame_id": {"clear": True}}
        ),
    )
