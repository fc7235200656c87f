"""A restricted subscriber receives, byte for byte, what ROS's own classes would have made.

The robot sends what genpy serialized; the reference deserializes that, changes the fields in plain
Python, and serializes again. Between them are channel, grant, filter and sockets.
"""

import asyncio
import io
import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from grants.model import Restriction, filter_rules
from tests.support.site import Site

pytestmark = pytest.mark.ros


def serialized(message: Any) -> bytes:
    buffer = io.BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def remade(data: bytes, change: Callable[[Any], None], kind: type[Any]) -> bytes:
    """Deserialize, modify, serialize: genpy at every step."""
    message = kind()
    message.deserialize(data)
    change(message)
    return serialized(message)


def rounded(value: float, step: float) -> float:
    return math.floor(value / step + 0.5) * step if math.isfinite(value) else value


async def received(
    path: Path, type_name: str, rules: dict[str, dict[str, object]], messages: Sequence[bytes]
) -> list[bytes]:
    """Send `messages` through a real pair of nodes; what a subscriber under `rules` receives."""
    restriction = Restriction(type=type_name, filters=filter_rules(rules))
    async with Site(path / "site").running() as site:
        site.publish("/robot", "/topic")
        site.subscribe("/heating", "/topic", restriction)
        async with site.node("/robot") as robot, site.node("/heating") as heating:
            publisher = await robot.publisher("/topic", type_name, queue_size=len(messages))
            subscriber = await heating.subscriber("/topic", type_name, queue_size=len(messages))
            await publisher.wait_for_subscribers()
            for message in messages:
                publisher.publish_bytes(message)
            raw = subscriber.raw()
            async with asyncio.timeout(20):
                return [await anext(raw) for _ in messages]


def stamp(header: Any, dice: np.random.Generator) -> None:
    header.seq = int(dice.integers(1 << 32))
    header.stamp.secs, header.stamp.nsecs = int(dice.integers(1 << 32)), int(dice.integers(10**9))
    header.frame_id = "living_room_map"[: int(dice.integers(16))]


@pytest.fixture
def dice() -> np.random.Generator:
    return np.random.default_rng(20)


async def test_a_genpy_subscriber_gets_rounded_poses_without_frame(
    tmp_path: Path, dice: np.random.Generator
) -> None:
    from geometry_msgs.msg import PoseStamped

    def make(scale: float) -> Any:
        message = PoseStamped()
        stamp(message.header, dice)
        position, orientation = message.pose.position, message.pose.orientation
        position.x, position.y, position.z = map(float, dice.normal(0, scale, 3))
        orientation.x, orientation.y, orientation.z, orientation.w = map(float, dice.normal(size=4))
        return message

    def change(message: Any) -> None:
        position = message.pose.position
        position.x, position.y, position.z = (
            rounded(value, 2.0) for value in (position.x, position.y, position.z)
        )
        message.header.frame_id = ""

    made = [make(scale) for scale in (1e-3, 1.0, 10.0, 1e3, 1e9, 1e17)]
    for message, value in zip(made, (-0.0, 1.0, -1.0, math.nan, math.inf, -math.inf), strict=True):
        message.pose.position.z = value  # ties, signed zero, NaN and infinity
    sent = [serialized(message) for message in made]
    rules: dict[str, dict[str, object]] = {
        "pose.position": {"round": {"step": 2.0}},
        "header.frame_id": {"clear": True},
    }
    got = await received(tmp_path, "geometry_msgs/PoseStamped", rules, sent)
    assert got == [remade(data, change, PoseStamped) for data in sent]
    assert got != sent


async def test_a_genpy_subscriber_gets_rounded_scans_without_intensities(
    tmp_path: Path, dice: np.random.Generator
) -> None:
    from sensor_msgs.msg import LaserScan

    def make(rays: int) -> Any:
        message = LaserScan()
        stamp(message.header, dice)
        message.angle_min, message.angle_max = -math.pi, math.pi
        message.angle_increment = 2 * math.pi / max(rays, 1)
        message.ranges = [float(value) for value in dice.normal(0, 4, rays).astype(np.float32)]
        message.intensities = [float(value) for value in dice.random(rays, np.float32)]
        return message

    def change(message: Any) -> None:
        message.ranges = [rounded(value, 0.1) for value in message.ranges]
        message.intensities = []

    made = [make(rays) for rays in (0, 1, 7, 360, 1081, 20_000)]
    odd = (math.nan, math.inf, -math.inf, -0.0, 0.05, 0.15, -0.05, 1e-45, 1e-7, 1e30, 3e38)
    (payload,) = struct.unpack("<f", struct.pack("<I", 0x7FC12345))  # a NaN with a payload
    for message in made[2:]:
        message.ranges[: len(odd) + 1] = [*odd, payload]
    sent = [serialized(message) for message in made]
    rules: dict[str, dict[str, object]] = {"ranges": {"round": {"step": 0.1}}, "intensities": {"clear": True}}
    got = await received(tmp_path, "sensor_msgs/LaserScan", rules, sent)
    assert got == [remade(data, change, LaserScan) for data in sent]


@pytest.mark.parametrize("pixels", [True, False], ids=["pixels kept", "pixels cleared"])
async def test_a_genpy_subscriber_gets_images_without_frame(
    tmp_path: Path, dice: np.random.Generator, pixels: bool
) -> None:
    from sensor_msgs.msg import Image

    def make(width: int, height: int) -> Any:
        message = Image(width=width, height=height, encoding="rgb8", step=3 * width)
        stamp(message.header, dice)
        message.data = dice.bytes(3 * width * height)
        return message

    def change(message: Any) -> None:
        message.header.frame_id = ""
        if not pixels:
            message.data = b""

    sent = [serialized(make(*size)) for size in ((0, 0), (1, 1), (5, 3), (160, 120), (640, 480))]
    rules: dict[str, dict[str, object]] = {"header.frame_id": {"clear": True}}
    if not pixels:
        rules["data"] = {"clear": True}
    got = await received(tmp_path, "sensor_msgs/Image", rules, sent)
    assert got == [remade(data, change, Image) for data in sent]
