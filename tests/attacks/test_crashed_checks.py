"""A check that fails is a refusal: attack F1, against a running master."""

import asyncio
import contextlib
from typing import Any, Final

import pytest

from grants.decision import Reach
from grants.model import Right
from rossec.errors import ChannelError, RossecError
from rossec.master.rights.statements import TrustState
from rossec.ros import xmlrpc
from tests.support.attacker import EVE, call, credentials
from tests.support.caller import caller
from tests.support.site import Site
from tests.support.witness import until

T = "std_msgs/String"
EVERYTHING: Final = {"/**": Right(255)}


def _crash(*_: object, **__: object) -> Any:
    raise RuntimeError("a fault in the guard")


GUARDS: Final[list[tuple[type, str]]] = [(TrustState, "caller"), (TrustState, "_confirm"), (Reach, "covers")]


@pytest.mark.attack("crashed-check")
@pytest.mark.parametrize(("where", "name"), GUARDS, ids=[name for _, name in GUARDS])
async def test_f1_a_check_that_crashes_admits_no_caller(
    site: Site, monkeypatch: pytest.MonkeyPatch, where: type, name: str
) -> None:
    assert site.master is not None
    async with caller(site, EVE, EVERYTHING) as eve:
        with monkeypatch.context() as patch:
            patch.setattr(where, name, _crash)
            for method, *params in (
                ("registerPublisher", "/t", T, eve.uri),
                ("setParam", "/p", 1),
                ("shutdown", "now"),
            ):
                with contextlib.suppress(RossecError, xmlrpc.Fault):
                    assert (await eve(method, *params))[0] == -1
        assert not list(site.master.state.registry.nodes())
        assert not site.master.effects.stopping.is_set()
    async with caller(site, EVE) as eve:
        assert (await eve("hasParam", "/p"))[2] is False


@pytest.mark.attack("crashed-check")
async def test_f1_a_crash_while_an_identity_is_checked_ends_the_connection(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert site.master is not None
    assert site.master._server is not None
    server, own = site.master._server, credentials(site)
    loop, seen = asyncio.get_running_loop(), list[Any]()
    loop.set_exception_handler(lambda _, context: seen.append(context))
    with monkeypatch.context() as patch:
        patch.setattr("ca.certificates.check_time", _crash)
        async with asyncio.timeout(3):  # before the deadline of the handshake
            with pytest.raises(ChannelError):
                await call(site.master.uri, own, "getPid", EVE)
    await until(lambda: server.connections == 0, within=3)
    assert "a fault in the guard" in str(seen[0]["exception"])
    async with caller(site, EVE) as eve:
        assert (await eve("getPid"))[0] == 1


CALL = xmlrpc.dump_call("registerPublisher", (EVE, "/t", T, "http://127.0.0.1:9/"))
