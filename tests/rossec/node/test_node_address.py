"""A node that gives away an address of another host says so when it starts."""

import logging
from pathlib import Path

import pytest

from rossec.node import Node
from tests.support.site import Site


async def test_an_address_of_another_host_is_said_at_the_start(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot")
        async with Node("/robot", environ={**site.environ, "ROS_IP": "192.0.2.7"}):
            pass
    [line] = [each.getMessage() for each in caplog.records if each.levelno == logging.WARNING]
    assert line.startswith("/robot: ROS_IP is 192.0.2.7, which is no address of this host: ")
    assert "unset ROS_IP" in line


async def test_an_address_of_this_host_is_not(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async with Site(tmp_path / "site").running() as site:
        site.enroll("/robot")
        async with Node("/robot", environ={**site.environ, "ROS_IP": "127.0.0.1"}):
            pass
    assert "no address of this host" not in caplog.text
