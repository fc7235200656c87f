"""`rossec namespace serve` in this process, against a real master, and nodes that call it."""

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from rossec.cli import namespace as module
from rossec.cli.shared.context import Environment
from rossec.errors import RossecError, RulesRefused
from rossec.host.runner import stop_on_signals
from rossec.namespace.topic_names import SERVICE, service_type
from rossec.naming import rule_runner
from tests.support.site import Site

PHONE = rule_runner.shipped_example("phone.xml").decode()


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    site.grant("/namespace", Right.PROVIDE, SERVICE)
    site.grant("/phone", Right.CALL, SERVICE)
    async with site.running():
        yield site


@contextlib.asynccontextmanager
async def served(site: Site, rules: bytes, *, as_json: bool) -> AsyncIterator[None]:
    """The service as a task; it ends as by Ctrl-C."""
    assert threading.current_thread() is threading.main_thread()
    environment = Environment(site.environ)
    running = asyncio.ensure_future(module._serve(environment, "/namespace", rules, as_json=as_json))
    try:
        yield
    finally:
        if not running.done():
            os.kill(os.getpid(), signal.SIGTERM)
        async with asyncio.timeout(30):
            await running


async def test_it_answers_until_it_is_ended(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    kind = service_type()
    stop_on_signals()  # SIGTERM never ends the tests
    async with site.node("/phone") as phone, served(site, rule_runner.shipped_rules(), as_json=True):
        await phone.wait_for_service(SERVICE, timeout=60)
        answer = await phone.client(SERVICE, kind.name)(name="temperature", metadata=PHONE)
        assert answer.topicname == "/building1/room3/sensors/temperature"
        with pytest.raises(RossecError, match="no name for the topic 'x'"):
            await phone.client(SERVICE, kind.name)(name="x", metadata=PHONE)
    assert capsys.readouterr().out == '{"ready": "/namespace"}\n'


async def test_rules_that_are_refused_end_it_before_it_serves(site: Site) -> None:
    environment = Environment(site.environ)
    with pytest.raises(RulesRefused):
        await module._serve(environment, "/namespace", b"<nothing/>", as_json=False)
