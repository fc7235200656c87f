"""A peer that exhausts a shared resource: others keep their share."""

import logging
from pathlib import Path

import pytest

from grants.model import Right
from rossec.master.operation.admin import DENIALS, DenialRateLimit
from rossec.master.operation.config import MasterLimits
from rossec.master.server.effects import MAX_LINES, DenialLog
from tests.support.attacker import EVE
from tests.support.caller import Caller, caller
from tests.support.site import Site

ROBOT = "/robot"


async def flood(eve: Caller, names: int) -> None:
    """Make refused calls for many names."""
    for first in range(0, names, 500):
        wanted = range(first, min(names, first + 500))
        params = ([eve.name, f"/wanted/p{number}"] for number in wanted)
        calls = [{"methodName": "getParam", "params": each} for each in params]
        await eve.client.call("system.multicall", calls)


@pytest.mark.attack("log-share")
async def test_one_node_cannot_fill_the_log_of_denials(tmp_path: Path) -> None:
    """A policy is learnt from it, so one node must not displace the others."""
    site = Site(tmp_path / "site")
    log = DenialLog(tmp_path / "denial_log")
    site.on_denial = log
    async with site.running(), caller(site, EVE) as eve, caller(site, ROBOT) as robot:
        await flood(eve, MAX_LINES + 2000)
        assert (await robot("getParam", "/robot/speed"))[0] == -1
    log.close()
    lines = (tmp_path / "denial_log").read_text().splitlines()
    assert [line for line in lines if "/robot/speed" in line]
    assert len(lines) < MAX_LINES + 2000


@pytest.mark.attack("log-share")
async def test_nodes_cannot_suppress_the_audit_of_others(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    denials, throttle = logging.getLogger(DENIALS), DenialRateLimit(lambda: 0.0)
    denials.addFilter(throttle)
    try:
        for number in range(7):
            async with caller(site, f"/eve{number}") as eve:
                await flood(eve, 300)
        async with caller(site, ROBOT) as robot:
            assert (await robot("getParam", "/robot/speed"))[0] == -1
    finally:
        denials.removeFilter(throttle)
    assert "/robot may not param-get /robot/speed" in caplog.text
    assert len(caplog.records) < 2000


@pytest.mark.attack("parameter-share")
async def test_one_node_cannot_use_all_parameter_memory(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.limits = MasterLimits(parameters=256 * 1024)
    async with (
        site.running(),
        caller(site, EVE, {"/eve/**": Right.PARAM_SET}) as eve,
        caller(site, ROBOT, {"/robot/**": Right.PARAM_SET}) as robot,
    ):
        for size in (100_000, 10_000, 1000, 100, 10):
            for number in range(20):
                await eve("setParam", f"/eve/p{size}/n{number}", "x" * size)
        code, status, _ = await eve("setParam", "/eve/more", "x" * 1000)
        assert (code, "/eve has set would take more than" in status) == (-1, True)
        assert (await robot("setParam", "/robot/speed", "x" * 100_000))[0] == 1
