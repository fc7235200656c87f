"""A home as the authority's service shows it to the console: real signed grants, made-up nodes."""

import hashlib
from dataclasses import dataclass, field
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.keys.signing import KeySigner
from grants import document
from grants.model import Draft, Permission, Restriction, Right, filter_rules
from rossec.authority.console.messages import (
    DenialView,
    EventView,
    FactView,
    GrantQuestion,
    GrantView,
    NodeView,
    Status,
)
from rossec.console.matrix import Heard, Matrix, ShownGrant, build, held_grants
from rossec.console.sentences import KnownIds
from tests.support import consoleservice

NOW: Final = 1_800_000_000
HOUR: Final = 3600
POSE: Final = "geometry_msgs/PoseStamped"
CA: Final = KeySigner(ec.derive_private_key(7, ec.SECP256R1()))
COARSE: Final = Restriction(
    POSE,
    (),
    filter_rules(
        {
            "header.frame_id": {"clear": True},
            "pose.orientation": {"clear": True},
            "pose.position": {"round": {"step": 2.0}},
        }
    ),
)
HOSTILE: Final = "<script>alert('\u202e')</script>&\"" + "x" * 200
"""A text as a hostile node would choose it; names of ROS themselves are ASCII."""


def key_of(name: str) -> bytes:
    return hashlib.sha256(name.encode()).digest()


def sees(topic: str, restriction: Restriction | None = None) -> Permission:
    return Permission(topic, Right.SUBSCRIBE, restriction)


def sends(topic: str) -> Permission:
    return Permission(topic, Right.PUBLISH)


STATUS: Final = Status("home", "8f4a 11c2", False, 600, 7, NOW, 1, True)


@dataclass
class FakeHome:
    """What the service would answer; `held`, `matrix` and `known` follow from it."""

    nodes: list[NodeView] = field(default_factory=list)
    grants: list[GrantView] = field(default_factory=list)
    facts: list[FactView] = field(default_factory=list)
    events: list[EventView] = field(default_factory=list)
    denials: list[DenialView] = field(default_factory=list)
    questions: list[GrantQuestion] = field(default_factory=list)
    status: Status = STATUS
    heard: Heard = field(default_factory=lambda: Heard(NOW))  # every node knows what was ended

    def node(self, name: str, revoked_at: int = 0, reason: str = "") -> NodeView:
        made = NodeView(name, key_of(name), NOW - HOUR, NOW + 30 * 86400, False, revoked_at, reason)
        self.nodes.append(made)
        self._event("certificate", name, made.key.hex(), NOW - HOUR)
        return made

    def grant(
        self,
        name: str,
        *permissions: Permission,
        last: int = 24 * HOUR,
        at: int = NOW - HOUR,
        cap: int = 0,
        revoked_at: int = 0,
        reason: str = "",
    ) -> GrantView:
        end = at + last
        cap = max(cap, end)
        serial = len(self.grants).to_bytes(16)
        draft = Draft("home", name, key_of(name), at, end, cap, serial, permissions)
        data = document.sign(CA, draft)
        made = GrantView(document.grant_id(data), name, data, at, end, cap, revoked_at, reason, "", "held")
        self.grants.append(made)
        self._event("grant", name, made.id.hex(), at)
        if revoked_at:
            self._event("revocation", made.id.hex(), reason, revoked_at)
        return made

    def publisher(self, topic: str, node: str, kind: str) -> None:
        self.facts += [FactView("publisher", topic, node), FactView("type", topic, kind)]

    def _event(self, what: str, subject: str, detail: str, at: int) -> None:
        self.events.insert(0, EventView(len(self.events), at, what, subject, detail))

    @property
    def held(self) -> tuple[ShownGrant, ...]:
        return held_grants(self.nodes, self.grants, NOW, self.heard)

    @property
    def matrix(self) -> Matrix:
        return build(self.held, self.facts, NOW)

    @property
    def known(self) -> KnownIds:
        return KnownIds.of(self.held, self.nodes, self.questions)


def demo() -> FakeHome:
    """The story of `make demo`: a robot, the doctor, the heating."""
    home = FakeHome()
    for name in ("/robot", "/doctor", "/heating"):
        home.node(name)
    for topic, kind in (
        ("/robot/pose", POSE),
        ("/robot/scan", "sensor_msgs/LaserScan"),
        ("/robot/camera", "sensor_msgs/Image"),
    ):
        home.publisher(topic, "/robot", kind)
    home.grant("/robot", sends("/robot/pose"), sends("/robot/scan"), sends("/robot/camera"))
    home.grant("/doctor", sees("/robot/pose"), sees("/robot/scan"))
    home.grant("/doctor", sees("/robot/camera"), revoked_at=NOW - 1800, reason="the visit is over")
    home.grant("/heating", sees("/robot/pose", COARSE))
    home.denials.append(DenialView(NOW - 960, "/heating", int(Right.SUBSCRIBE), "/robot/scan"))
    return home


def crowd(nodes: int = 30, topics: int = 40) -> FakeHome:
    """A large home in which every node sees a third of all topics."""
    home = FakeHome()
    robot, seen = ("/a_robot_with_a_long_name", [f"/robot/sensor_{at:02}/data" for at in range(topics)])
    home.node(robot)
    home.grant(robot, *map(sends, seen))
    for topic in seen:
        home.publisher(topic, robot, POSE)
    for at in range(nodes - 1):
        name = f"/receiver_{at:02}"
        home.node(name)
        some = seen[at % 3 :: 3]
        home.grant(name, *(sees(topic, COARSE if at % 2 else None) for topic in some))
    home.denials += [
        DenialView(NOW - at, f"/receiver_{at % 29:02}", 2, f"/robot/other_{at:03}") for at in range(400)
    ]
    return home


def as_service(home: FakeHome) -> consoleservice.FakeHome:
    """The same home, behind the operations of the service."""
    made = consoleservice.FakeHome()
    made.nodes, made.grants, made.graph = home.nodes, home.grants, home.facts
    made.events, made.denials = home.events[::-1], home.denials
    made.questions, made.requests, made.proposals = home.questions, [], []
    made.now = NOW
    return made
