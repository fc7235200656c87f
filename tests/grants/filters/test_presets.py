"""Presets: what they reveal to an attacker who keeps every message."""

import itertools
import math
import struct
from collections.abc import Iterator

import numpy as np
import pytest

from grants.decision import Decision
from grants.errors import FilterRefused, MessageRefused
from grants.filters.compile import PRESETS, preset
from grants.filters.layout import Layout, parse
from grants.guard import Guard
from grants.model import Restriction, Right, filter_rules
from rossec.participant.message_types import message_type
from tests.grants.messages import layout, seeded_random

NOW = 1_800_000_000
SCAN = 10  # messages a second


def shape(name: str) -> Layout:
    return parse(name, message_type(name).definition)


POSE = shape("geometry_msgs/PoseStamped")
COARSE = preset("coarse-position").restriction(POSE)


def guard(restriction: Restriction, of: Layout = POSE) -> Guard:
    return Guard(
        of, Decision(Right.SUBSCRIBE, "/pose", (), NOW + 10**6, (restriction,)), {"diagnostics": bytes(32)}
    )


def pose(n: int, x: float) -> bytes:
    stamp = struct.pack("<III", n, NOW + n // SCAN, n % SCAN * 10**8)
    return stamp + struct.pack("<I3s7d", 3, b"map", x, 0.0, 0.0, 0.6, 0.0, 0.0, 0.8)


def observed(restriction: Restriction, walk: list[float]) -> Iterator[tuple[int, float]]:
    """The times and positions an attacker receives of a walk at 10 messages a second."""
    one = guard(restriction)
    for n, x in enumerate(walk):
        pieces = one.apply(pose(n, x), NOW + n / SCAN)
        if pieces is not None:
            yield n, struct.unpack_from("<d", b"".join(pieces), 19)[0]


def only_rounded(step: float) -> Restriction:
    return Restriction(POSE.type_name, (), filter_rules({"pose.position": {"round": {"step": step}}}))


def noisy(x: float, minutes: int = 10) -> list[float]:
    """A robot that stands at `x`, seen by a sensor with 5 cm of noise."""
    rng = seeded_random(7)
    return [x + rng.gauss(0, 0.05) for _ in range(minutes * 60 * SCAN)]


def test_averaging_reveals_only_the_cell() -> None:
    """The mean of all messages reveals no more than one message: the cell."""
    for x in (0.4, 3.137, -5.3):
        positions = {seen for _, seen in observed(COARSE, noisy(x))}
        assert positions == {math.floor(x / 4 + 0.5) * 4.0}


def test_hysteresis_hides_the_border_of_a_cell() -> None:
    """1 cm beside a border changes reveal the position without hysteresis, not with it."""
    walk = noisy(1.99)
    betrayed = [seen for _, seen in observed(only_rounded(4.0), walk)]
    share = sum(seen == 4.0 for seen in betrayed) / len(betrayed)
    # The share of changes is the normal distribution at the border: the attack works.
    deviation = abs(share - 0.5 * math.erfc(0.01 / 0.05 / math.sqrt(2)))
    assert deviation < 0.03
    assert {seen for _, seen in observed(COARSE, walk)} <= {0.0, 4.0}
    assert len({seen for _, seen in observed(COARSE, walk)}) == 1


def test_the_slot_hides_the_time_of_a_change() -> None:
    """At full rate the time of a change is exact; the preset's slot leaves 30 s of uncertainty."""
    walk = [0.5 * n / SCAN for n in range(300 * SCAN)]  # 0.5 m/s
    exact = list(observed(only_rounded(2.0), walk))
    changes = [n for (_, a), (n, b) in itertools.pairwise(exact) if a != b]
    assert max(abs((walk[n] % 2) - 1) for n in changes) < 0.06
    coarse = [n for n, _ in observed(COARSE, walk)]
    assert [b - a for a, b in itertools.pairwise(coarse)] == [30 * SCAN] * 8


def test_coarse_position_treats_related_fields() -> None:
    one = guard(COARSE)
    assert one.apply(pose(1234, 0.3), NOW - 1) is None, "the first slot tells no beginning"
    made = one.apply(pose(1234, 0.3), NOW)
    assert made is not None
    seq, seconds, nanoseconds = struct.unpack_from("<III", b"".join(made))
    assert (seq, seconds % 60, nanoseconds) == (0, 0, 0)
    assert b"".join(made)[19:] == bytes(56)


@pytest.mark.parametrize(
    ("name", "type_name"),
    [
        ("coarse-position", "geometry_msgs/PoseStamped"),
        ("coarse-position", "geometry_msgs/PoseWithCovarianceStamped"),
        ("coarse-position", "geometry_msgs/PointStamped"),
        ("coarse-position", "nav_msgs/Odometry"),
        ("coarse-position", "sensor_msgs/NavSatFix"),
        ("coarse-position", "sensor_msgs/JointState"),
        ("presence-only", "sensor_msgs/Image"),
        ("presence-only", "std_msgs/String"),
        ("presence-only", "std_msgs/Empty"),
        ("anonymous-diagnostics", "diagnostic_msgs/DiagnosticArray"),
    ],
)
def test_presets_fit_their_types(name: str, type_name: str) -> None:
    of = shape(type_name)
    restriction = preset(name).restriction(of)
    message = bytes(message_type(type_name).serialize(message_type(type_name).create()))
    one = guard(restriction, of)
    one.apply(message, NOW - 1)
    assert one.apply(message, NOW + (0 if restriction.slot else 60)) is not None


def test_presence_only_clears_every_field() -> None:
    of = shape("sensor_msgs/Image")
    kind = message_type("sensor_msgs/Image")
    full = kind.create(height=1, width=1, encoding="mono8", step=1)
    one = guard(preset("presence-only").restriction(of), of)
    assert one.apply(kind.serialize(full), NOW - 1) is None, "not the moment it begins"
    treated = one.apply(kind.serialize(full), NOW)
    assert treated is not None
    assert not any(b"".join(treated))


def test_blurred_camera_keeps_one_of_eight_greys_per_square() -> None:
    """Also of noise, whose means are all near the middle; an inconsistent picture is dropped."""
    of, kind = shape("sensor_msgs/Image"), message_type("sensor_msgs/Image")
    one = guard(preset("blurred-camera").restriction(of), of)
    data = np.frombuffer(seeded_random(1).randbytes(64 * 64), np.uint8)
    full = kind.create(height=64, width=64, encoding="mono8", step=64, data=data)
    treated = one.apply(kind.serialize(full), NOW)
    assert treated is not None
    assert set(b"".join(treated)[-64 * 64 :]) <= {109, 145}
    with pytest.raises(MessageRefused):
        one.apply(kind.serialize(kind.create(encoding="bayer_rggb8")), NOW + 1)


def test_every_preset_states_what_it_reveals() -> None:
    assert list(PRESETS) == ["coarse-position", "presence-only", "anonymous-diagnostics", "blurred-camera"]
    for entry in PRESETS.values():
        assert entry.hides
        assert entry.reveals


def test_unknown_presets_and_types_are_refused() -> None:
    with pytest.raises(FilterRefused, match="no preset 'coarse'") as refused:
        preset("coarse")
    assert refused.value.hint.startswith("expected one of coarse-position")
    with pytest.raises(FilterRefused, match="the preset does not support t/T"):
        preset("coarse-position").restriction(layout("int32 a"))
    with pytest.raises(FilterRefused, match="the preset does not support sensor_msgs/LaserScan"):
        preset("coarse-position").restriction(shape("sensor_msgs/LaserScan"))


def test_a_grant_keeps_what_its_preset_said_when_it_was_signed() -> None:
    """A grant holds the filters themselves: that of the version before still has two metres."""
    before = Restriction(
        POSE.type_name,
        (),
        filter_rules(
            {
                "header.seq": {"clear": True},
                "header.stamp": {"round": {"step": 10}},
                "pose.orientation": {"clear": True},
                "pose.position": {"round": {"step": 2.0, "hysteresis": 0.5}},
            }
        ),
        0.2,
    )
    walk = [0.5 * n / SCAN for n in range(60 * SCAN)]
    told = list(observed(before, walk))
    assert {seen % 2 for _, seen in told} == {0.0}
    assert max(abs(walk[n] - seen) for n, seen in told) <= 1.5
    assert [b - a for (a, _), (b, _) in itertools.pairwise(told)] == [5 * SCAN] * 11


def diagnostics(*parts: tuple[int, str]) -> bytes:
    kind = message_type("diagnostic_msgs/DiagnosticArray")
    status = message_type("diagnostic_msgs/DiagnosticStatus")
    found = [
        status.create(level=level, name=f"the name of {part}", hardware_id=part) for level, part in parts
    ]
    return bytes(kind.serialize(kind.create(status=found)))


def test_anonymous_diagnostics_have_no_order_and_no_names() -> None:
    of = shape("diagnostic_msgs/DiagnosticArray")
    parts = [(0, "arm"), (2, "wheel"), (0, "lamp")]
    told = []
    for order in itertools.permutations(parts):
        pieces = guard(preset("anonymous-diagnostics").restriction(of), of).apply(diagnostics(*order), NOW)
        assert pieces is not None
        told.append(b"".join(pieces))
    assert len(set(told)) == 1
    assert not any(name in told[0] for name in (b"the name", b"arm", b"wheel", b"lamp"))
