"""Grants: filters against genpy, conditions, verification against a raw signature.

Both sides of every ratio are measured in this process, in turns, and the minimum over the turns is
taken: other work on the machine only ever adds time. genpy's side does what a node without wire
filters has to do: deserialize, change the fields, serialize.
"""

import importlib
import itertools
import math
import timeit
from collections.abc import Callable
from io import BytesIO
from typing import Any

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from bench import policy
from ca.keys.signing import KeySigner
from grants.conditions import compile_condition
from grants.document import open_grant, sign
from grants.filters.compile import compile_filter
from grants.filters.layout import Layout, parse
from grants.model import Draft, Permission, Restriction, Right, filter_rules

NOW = 1_800_000_000
ROUNDS = 7

Rules = dict[str, dict[str, object]]
Case = tuple[Any, Rules, Callable[[Any], None]]


def measure(seconds: float) -> dict[str, object]:
    """Run everything in about `seconds`; times in microseconds."""
    cases = _cases()
    each = seconds / (2 * len(cases) + 6) / ROUNDS
    figures = {name: _filter(*case, each) for name, case in cases.items()}
    first, verify, raw, signing = _verify(each)
    return {
        "filter_us": {name: round(wire, 3) for name, (wire, _) in figures.items()},
        "filter_vs_genpy": {name: round(genpy / wire, 2) for name, (wire, genpy) in figures.items()},
        "condition_us": {name: round(us, 3) for name, us in _conditions(each).items()},
        "verify_us": round(verify, 1),
        "verify_vs_raw": round(verify / raw, 3),
        "verify_new_rights_vs_raw": round(first / raw, 3),
        "sign_us": round(signing, 1),
        **policy.measure(min(3.0, seconds / 4)),
    }


def shortest_us(seconds: float, *actions: Callable[[], object]) -> list[float]:
    """The shortest time of each action, taking turns."""
    timers = [timeit.Timer(action) for action in actions]
    counts = [max(1, int(seconds / max(timer.timeit(3) / 3, 1e-8))) for timer in timers]
    best = [math.inf] * len(timers)
    for _ in range(ROUNDS):
        for n, (timer, count) in enumerate(zip(timers, counts, strict=True)):
            best[n] = min(best[n], timer.timeit(count) / count * 1e6)
    return best


def _message(type_name: str, /, **fields: Any) -> Any:
    package, kind = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)(**fields)


def _layout(kind: Any) -> Layout:
    return parse(kind._type, kind._full_text)  # noqa: SLF001 - genpy's public names


def _serialized(message: Any) -> bytes:
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def _filter(message: Any, rules: Rules, change: Callable[[Any], None], seconds: float) -> tuple[float, float]:
    kind, data = type(message), _serialized(message)
    compiled = compile_filter(_layout(kind), filter_rules(rules))

    def by_genpy() -> bytes:
        decoded = kind().deserialize(data)
        change(decoded)
        return _serialized(decoded)

    if b"".join(compiled(data)) != by_genpy():
        raise AssertionError(f"{kind.__name__}: the two sides differ")
    wire, genpy = shortest_us(seconds, lambda: compiled(data), by_genpy)
    return wire, genpy


def _half(value: float) -> float:
    return math.floor(value / 0.5 + 0.5) * 0.5


def _round_point(point: Any) -> None:
    point.x, point.y, point.z = _half(point.x), _half(point.y), _half(point.z)


def _cases() -> dict[str, Case]:
    half: dict[str, object] = {"round": {"step": 0.5}}
    clear: dict[str, object] = {"clear": True}
    pose = _message("geometry_msgs/PoseStamped")
    pose.header.frame_id, pose.pose.position.x = "map", 1.3

    def change_pose(message: Any) -> None:
        _round_point(message.pose.position)
        message.header.frame_id = ""

    def change_scan(message: Any) -> None:
        message.ranges = [math.floor(value / 0.1 + 0.5) * 0.1 for value in message.ranges]

    def change_odometry(message: Any) -> None:
        _round_point(message.pose.pose.position)
        message.twist, message.child_frame_id = type(message.twist)(), ""

    def change_path(message: Any) -> None:
        for item in message.poses:
            _round_point(item.pose.position)

    def change_poses(message: Any) -> None:
        for item in message.poses:
            _round_point(item.position)

    scan = _message("sensor_msgs/LaserScan", ranges=[0.013 * n for n in range(720)])
    scan.intensities = scan.ranges
    image = _message("sensor_msgs/Image", data=bytes(1 << 20), encoding="rgb8")
    image.header.frame_id = "camera"
    return {
        "String": (_message("std_msgs/String", data="x" * 40), {"data": clear}, clear_data),
        "PoseStamped": (pose, {"pose.position": half, "header.frame_id": clear}, change_pose),
        "LaserScan 720": (scan, {"ranges": {"round": {"step": 0.1}}}, change_scan),
        "Odometry": (
            _message("nav_msgs/Odometry", child_frame_id="base"),
            {"pose.pose.position": half, "twist": clear, "child_frame_id": clear},
            change_odometry,
        ),
        "Image 1 MiB": (image, {"header.frame_id": clear}, clear_frame),
        "DiagnosticArray": (_diagnostics(), {"status[*].values": {"drop": True}}, drop_values),
        "Path 200": (
            _message("nav_msgs/Path", poses=[pose] * 200),
            {"poses[*].pose.position": half},
            change_path,
        ),
        "PoseArray 200": (
            _message("geometry_msgs/PoseArray", poses=[pose.pose] * 200),
            {"poses[*].position": half},
            change_poses,
        ),
    }


def clear_frame(message: Any) -> None:
    message.header.frame_id = ""


def clear_data(message: Any) -> None:
    message.data = ""


def drop_values(message: Any) -> None:
    for item in message.status:
        item.values = []


def _diagnostics() -> Any:
    values = [_message("diagnostic_msgs/KeyValue", key=f"key {n}", value="1.5") for n in range(4)]
    parts = {"name": "motor", "message": "ok", "hardware_id": "a1", "values": values}
    status = [_message("diagnostic_msgs/DiagnosticStatus", **parts) for _ in range(10)]
    return _message("diagnostic_msgs/DiagnosticArray", status=status)


def _conditions(seconds: float) -> dict[str, float]:
    pose = _message("geometry_msgs/PoseStamped")
    pose.header.frame_id, pose.pose.position.x = "map", 1.3
    shape, data = _layout(type(pose)), _serialized(pose)
    texts = {
        "field": "msg.pose.position.x > 0.0",
        "time": 'now.getHours("Europe/Zurich") >= 8',
        "field, time and text": "msg.pose.position.x > 0.0 && now.getHours() >= 8"
        ' && msg.header.frame_id == "map"',
    }
    compiled = {name: compile_condition(shape, text) for name, text in texts.items()}
    times = shortest_us(seconds, *[lambda c=c: c(data, NOW) for c in compiled.values()])
    return dict(zip(compiled, times, strict=True))


def _verify(seconds: float) -> tuple[float, float, float, float]:
    """Verify a grant with new rights, one with known rights, a bare ES256 signature; sign a grant.

    A bare ES256 signature is r || s (RFC 9053), as in every COSE and JOSE message.
    """
    key = ec.generate_private_key(ec.SECP256R1())
    signer, public = KeySigner(key), key.public_key()
    coarse = Restriction(
        "geometry_msgs/PoseStamped",
        ('msg.header.frame_id == "map"', "now.getHours() >= 8"),
        filter_rules({"pose.position": {"round": {"step": 0.5}}, "header": {"clear": True}}),
    )
    drafts = [
        Draft(
            "home",
            "/heating",
            bytes(32),
            NOW - 60,
            NOW + 60,
            NOW + 60,
            n.to_bytes(16),
            (
                Permission(f"/robot{n}/pose", Right.SUBSCRIBE, coarse),
                Permission("/heating/**", Right.PUBLISH),
            ),
        )
        for n in range(600)
    ]
    tokens = [sign(signer, draft) for draft in drafts]
    new = itertools.cycle(tokens)  # more scopes than are remembered: every one is read anew
    data, draft = tokens[0], drafts[0]
    raw = signer.sign(data)

    def by_hand() -> None:
        r, s = int.from_bytes(raw[:32]), int.from_bytes(raw[32:])
        public.verify(encode_dss_signature(r, s), data, ec.ECDSA(hashes.SHA256()))

    first, again, bare, signing = shortest_us(
        seconds,
        lambda: open_grant(next(new), public, NOW),
        lambda: open_grant(data, public, NOW),
        by_hand,
        lambda: sign(signer, draft),
    )
    return first, again, bare, signing
