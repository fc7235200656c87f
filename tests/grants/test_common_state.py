"""One hysteresis for all holders of a topic, and for all topics of one body."""

import itertools
import struct
from types import SimpleNamespace
from typing import Any

import pytest

from grants.decision import Decision
from grants.errors import GrantError
from grants.filters.coarsening import BodyFields, CommonState, frame_reader, group_of
from grants.filters.layout import parse
from grants.guard import Guard, MemoryScope, MemoryStore
from grants.model import Restriction, Right, filter_rules
from rossec.participant.message_types import message_type

NOW = 1_800_000_000
POSE, ODOMETRY = "geometry_msgs/PoseStamped", "nav_msgs/Odometry"
ROUND = {"round": {"step": 4.0, "hysteresis": 2.0}}
PATHS = {POSE: "pose.position", ODOMETRY: "pose.pose.position"}


def decision(holder: int, name: str, *restrictions: Restriction) -> Decision:
    grant: Any = SimpleNamespace(holder=bytes([holder]) * 32, chain=())
    grant.links = (grant,)
    return Decision(Right.SUBSCRIBE, name, (grant,), NOW * 2, restrictions)


class Robot:
    """A publisher of poses and odometry, and what receivers read."""

    def __init__(self, body: str | None = None, slot: int | None = None) -> None:
        self._scope = MemoryScope(MemoryStore(lambda: NOW), ("/robot",))
        self._body, self._slot = body, slot

    def guard(self, holder: int, kind: str = POSE) -> Guard:
        rules = filter_rules({PATHS[kind]: ROUND})
        restriction = Restriction(kind, (), rules, slot=self._slot, body=self._body)
        layout = parse(kind, message_type(kind).definition)
        return Guard(layout, decision(holder, f"/{kind}", restriction), {}, self._scope)


def message(x: float, kind: str = POSE, frame: bytes = b"map") -> bytes:
    head = struct.pack("<III", 0, 0, 0) + struct.pack("<I", len(frame)) + frame
    tail = 32 if kind == POSE else 32 + 36 * 8 + 6 * 8 + 36 * 8
    child = b"" if kind == POSE else bytes(4)
    return head + child + struct.pack("<3d", x, 0, 0) + bytes(tail)


def told(guard: Guard, data: bytes, at: float = 0) -> float | None:
    pieces = guard.apply(data, NOW + at)
    if pieces is None:
        return None
    found = b"".join(pieces)
    size = int.from_bytes(found[12:16], "little")
    start = 16 + size + (4 if len(found) > 200 else 0)
    return float(struct.unpack_from("<d", found, start)[0])


@pytest.mark.attack("common-moments")
def test_a_second_receiver_is_told_the_same() -> None:
    """Rounded anew for the second, the two would know on which side of the border it is."""
    robot = Robot()
    first, second = robot.guard(1), robot.guard(2)
    assert told(first, message(1.9)) == 0.0
    for x in (1.9, 2.1, 3.9):
        assert told(second, message(x)) == told(first, message(x)) == 0.0
    assert told(second, message(4.1)) == told(first, message(3.9)) == 4.0


@pytest.mark.attack("common-moments")
def test_all_topics_of_a_body_are_told_the_same() -> None:
    for body in ("robot", None):
        robot = Robot(body, 30)
        poses, odometry = robot.guard(1), robot.guard(2, ODOMETRY)
        for one, data in ((poses, message(1.9)), (odometry, message(2.1, ODOMETRY))):
            assert told(one, data, -1) is None, "the first slot tells no beginning"
        assert told(poses, message(1.9)) == 0.0
        same = told(odometry, message(2.1, ODOMETRY), 0.1)
        assert same == (0.0 if body else 4.0)


@pytest.mark.attack("common-moments")
def test_a_body_is_told_in_one_frame() -> None:
    """Cells of two frames are shifted and intersect; the first is told, while it comes."""
    robot = Robot("robot", 30)
    poses, odometry = robot.guard(1), robot.guard(1, ODOMETRY)
    shifted = message(1.0, ODOMETRY, b"odom")
    for at in range(-30, 90, 30):
        here = told(poses, message(1.0), at), told(odometry, shifted, at + 0.1)
        assert here == (None if at < 0 else 0.0, None)
    assert told(odometry, shifted, 90) is None
    assert told(odometry, shifted, 120) == 0.0, "the other one comes no more"


def test_each_frame_has_its_own_value() -> None:
    common = CommonState()
    fields = BodyFields(common)
    state = fields.bind((0, "pose", "position", "x", "float64", ("step", 4.0)))
    again = fields.bind((0, "goal", "x", "float64", ("step", 4.0)))
    assert again is not state, "another point of the same message"
    for frame, value in ((b"map", 4.0), (b"odom", 8.0)):
        fields.load(frame)
        assert state.value is None
        state.value = value
        fields.store(frame)
    fields.load(b"map")
    assert state.value == 4.0
    assert again.value is None


def test_a_state_is_bounded_and_fresh_until_something_is_kept() -> None:
    common = CommonState()
    for number in range(4096):
        common.hysteresis((number,))
    with pytest.raises(GrantError, match="4096 fields with hysteresis"):
        common.hysteresis((4096,))
    assert common.is_fresh
    assert common.leads(b"map", 0, 10)
    assert not common.is_fresh


def test_two_bodies_for_one_right_are_refused() -> None:
    one, two = (Restriction(slot=30, body=body) for body in ("robot", "lift"))
    assert group_of(decision(1, "/a", one, one)) == (True, "robot")
    assert group_of(decision(1, "/a")) == (False, "/a")
    with pytest.raises(GrantError, match="name 2 bodies: lift, robot"):
        group_of(decision(1, "/a", one, two))


def test_the_frame_is_that_of_the_header() -> None:
    assert frame_reader(has_header=True)(memoryview(message(1.0, frame=b"home"))) == b"home"
    assert frame_reader(has_header=False)(message(1.0)) == b""
    assert [*itertools.islice(frame_reader(has_header=True)(b""), 1)] == []
