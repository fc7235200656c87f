"""Receivers try to see more than a level: in a large picture, and in what stands beside the value.

Every field of every type at every level: tests/grants/vocabulary/test_every_leaf.py.
"""

import contextlib
import struct
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
import pytest

from grants.filters.compile import preset
from grants.filters.layout import parse
from grants.model import Restriction
from grants.vocabulary.contents import DataWord, describe
from grants.vocabulary.levels import resolve
from rossec.participant.message_types import message_type
from tests.support.site import Site

IMAGE, BATTERY, GOALS = ("sensor_msgs/Image", "sensor_msgs/BatteryState", "actionlib_msgs/GoalStatusArray")
TOPIC = "/robot/seen"
HIGH, WIDE = 1080, 1920


def at_level(kind: str, level: str) -> Restriction:
    """A position at this level, without its rate: every message is compared."""
    layout = parse(kind, message_type(kind).definition)
    found = resolve(layout, describe(layout), {DataWord.POSITION: level})
    return Restriction(kind, (), found.rules)


@contextlib.asynccontextmanager
async def seen(site: Site, kind: str, given: Restriction) -> AsyncIterator[tuple[Any, Any]]:
    """A publisher on the robot, and what a receiver gets under the restriction."""
    site.publish("/robot", TOPIC)
    site.subscribe("/eve", TOPIC, given)
    async with site.node("/robot") as robot, site.node("/eve") as eve:
        publisher = await robot.publisher(TOPIC, kind)
        subscriber = await eve.subscriber(TOPIC, kind)
        await publisher.wait_for_subscribers(1)
        yield publisher, aiter(subscriber)


@pytest.mark.attack("large-pictures")
async def test_a_face_in_a_large_picture_is_one_square(site: Site) -> None:
    """A head of 96 pixels is 3.5 m away at 1080p: in squares of 32 pixels it had nine greys."""
    blurred = preset("blurred-camera").restriction(parse(IMAGE, message_type(IMAGE).definition))
    rng = np.random.default_rng(3)
    picture = rng.integers(0, 256, (HIGH, WIDE), np.uint8)
    async with seen(site, IMAGE, blurred) as (publisher, messages):
        publisher.publish(
            publisher.create(height=HIGH, width=WIDE, encoding="mono8", step=WIDE, data=picture.reshape(-1))
        )
        got = (await anext(messages)).data.reshape(HIGH, WIDE)
    borders = [np.flatnonzero((np.diff(got, axis=axis) != 0).any(1 - axis)) + 1 for axis in (0, 1)]
    for found in borders:
        assert len(found) < 16
        assert not (found % 120).any()
    assert len(np.unique(got)) <= 8


@pytest.mark.attack("large-pictures")
async def test_another_shape_for_the_same_bytes_shows_no_more(site: Site) -> None:
    """A program that sends the rows of a picture as one long row, or many short ones."""
    blurred = preset("blurred-camera").restriction(parse(IMAGE, message_type(IMAGE).definition))
    every = Restriction(IMAGE, (), blurred.filters)  # without its rate
    data = np.random.default_rng(4).integers(0, 256, 640 * 480, np.uint8)
    async with seen(site, IMAGE, every) as (publisher, messages):
        for high in (480, 1, 2, 4800, 640 * 480):
            wide = 640 * 480 // high
            publisher.publish(
                publisher.create(height=high, width=wide, encoding="mono8", step=wide, data=data)
            )
            got = (await anext(messages)).data.reshape(high, wide)
            for axis in (0, 1):
                changes = (np.diff(got, axis=axis) != 0).any(1 - axis)
                assert np.count_nonzero(changes) < 16


@pytest.mark.attack("told-beside")
@pytest.mark.parametrize("level", ["room", "no"])
async def test_a_battery_does_not_tell_the_dock(site: Site, level: str) -> None:
    """Charging or not, and the current of the wheels, beside a position that is hidden."""
    async with seen(site, BATTERY, at_level(BATTERY, level)) as (publisher, messages):
        got = []
        for status, current in ((1, 2.5), (2, -0.5), (2, -4.0)):
            publisher.publish(
                publisher.create(
                    power_supply_status=status,
                    current=current,
                    voltage=12 + current,
                    percentage=0.7,
                    cell_voltage=np.array([4 + current / 9] * 3, np.float32),
                    serial_number="7",
                )
            )
            got.append(await anext(messages))
    shown = [bytes(message_type(BATTERY).serialize(each)) for each in got]
    assert len(set(shown)) == 1
    assert struct.pack("<f", 0.7) not in shown[0]


@pytest.mark.attack("told-beside")
async def test_goals_do_not_tell_that_somebody_moves(site: Site) -> None:
    """Their number, their states, and the name that holds the sender, the time and a count."""
    status, goal = message_type("actionlib_msgs/GoalStatus"), message_type("actionlib_msgs/GoalID")
    async with seen(site, GOALS, at_level(GOALS, "no")) as (publisher, messages):
        got = []
        for number in range(3):
            listed = [
                status.create(goal_id=goal.create(id=f"/move_base-{n}-1795000000.5"), status=n)
                for n in range(number)
            ]
            publisher.publish(publisher.create(status_list=listed))
            got.append(await anext(messages))
    assert len({bytes(message_type(GOALS).serialize(each)) for each in got}) == 1
