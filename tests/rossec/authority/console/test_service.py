"""Operations to handlers: in threads of their parts, bounded answers, refusals."""

import asyncio
import threading
from collections.abc import Callable

import pytest

from ca.encoding import Value
from rossec.authority.console import messages
from rossec.authority.console.serving import ConsoleService
from rossec.authority.keyservice.messages import ServiceRequest
from rossec.authority.keyservice.process import AuditedCaller
from rossec.errors import KeyServiceRefused

CALLER = AuditedCaller(1, 2, "rossec console")


class Part:
    def __init__(self, **handlers: Callable[..., Value]) -> None:
        vars(self).update({name.replace("-", "_"): handler for name, handler in handlers.items()})


async def test_each_part_has_a_thread_and_waits_for_no_other() -> None:
    until = threading.Event()
    slow = Part(graph=lambda: until.wait(10) and threading.get_ident())
    fast = Part(status=threading.get_ident, redeem=lambda code: [threading.get_ident(), code])
    service = ConsoleService(slow, fast)
    async with asyncio.TaskGroup() as group:
        waiting = group.create_task(service.carry_out(ServiceRequest("graph"), CALLER))
        await asyncio.sleep(0)
        status = await service.carry_out(ServiceRequest("status"), CALLER)
        assert await service.carry_out(ServiceRequest("redeem", ("x",)), CALLER) == [status, "x"]
        until.set()
    assert waiting.result() not in {status, False, threading.get_ident()}
    await service.close()


async def test_an_operation_without_a_handler_is_refused() -> None:
    service = ConsoleService(Part(status=lambda: None))
    assert service.missing == messages.OPERATIONS.keys() - {"status"}
    with pytest.raises(KeyServiceRefused, match="does not do graph"):
        await service.carry_out(ServiceRequest("graph"), CALLER)
    await service.close()


async def test_an_answer_that_is_too_long_is_refused() -> None:
    service = ConsoleService(Part(nodes=lambda: bytes(messages.MAX_ANSWER)))
    with pytest.raises(KeyServiceRefused, match="the answer has more"):
        await service.carry_out(ServiceRequest("nodes"), CALLER)
    await service.close()


def test_an_operation_has_one_handler() -> None:
    parts = [Part(status=lambda: None) for _ in range(2)]
    with pytest.raises(ValueError, match="two handlers"):
        ConsoleService(*parts)


async def test_what_changes_something_is_audited_with_who_asked_before_it_is_done() -> None:
    lines: list[str] = []
    handlers: dict[str, Callable[..., Value]] = {
        "revoke-node": lambda *_: len(lines),
        "deny-request": lambda *_: len(lines),
        "status": lambda: len(lines),
    }
    service = ConsoleService(Part(**handlers), audit=lines.append)
    assert await service.carry_out(ServiceRequest("status"), CALLER) == 0
    assert await service.carry_out(ServiceRequest("revoke-node", ("/a\n/b", "why")), CALLER) == 1
    assert await service.carry_out(ServiceRequest("deny-request", (b"\1\2", "why")), CALLER) == 2
    assert "\n" not in lines[0]
    assert lines[1] == f"deny-request 0102, asked by the console of {CALLER}"
    await service.close()


async def test_what_cannot_be_audited_is_not_done() -> None:
    done: list[str] = []

    def full(_: str) -> None:
        raise KeyServiceRefused("the disk is full")

    handlers: dict[str, Callable[..., Value]] = {"remove-phone": lambda *_: done.append("x")}
    service = ConsoleService(Part(**handlers), audit=full)
    with pytest.raises(KeyServiceRefused, match="full"):
        await service.carry_out(ServiceRequest("remove-phone", (b"id", "")), CALLER)
    assert not done
    await service.close()
