"""One process, asked by a loop: what it answers late, wrongly or not at all."""

import asyncio
import gc
import os
import sys
import warnings
from pathlib import Path

import pytest

from ca.encoding import encode
from rossec.errors import RulesExceeded, RulesNotConfined
from rossec.naming import requests, rule_runner
from rossec.naming.rule_runner import RuleProcess
from tests.rossec.naming.stylesheets import RULES, request, sheet
from tests.support.witness import until

BODY = requests.write_request(request(RULES))
NAME = "/smartphones/schneider/htc_desire"
READY = "import os, sys, time\nos.write(1, b'\\0\\0\\0\\1\\0')\n"


def program(text: str) -> RuleProcess:
    """A process of this program instead."""
    return RuleProcess([sys.executable, "-I", "-c", text])


def is_alive(process: RuleProcess) -> bool:
    try:
        os.kill(process.worker.pid, 0)
    except ProcessLookupError:
        return False
    return True


async def test_it_answers_one_request_after_the_other() -> None:
    process = RuleProcess()
    try:
        for _ in range(2):
            assert requests.read_names(await process.ask(BODY, 60), 1) == [NAME]
    finally:
        process.close()
    assert not is_alive(process)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time.sleep(60)", "the rules took longer than 0.2 s"),
        ("os.read(0, 9)", "the process for rules ended"),
        ("os.write(1, b'\\xff\\xff\\xff\\xff'); time.sleep(60)", "where at most"),
        ("os.write(1, b'\\0\\0\\0\\0'); time.sleep(60)", "where at most"),
        ("os.write(1, b'\\0\\0\\0\\5ab')", "the process for rules ended"),
    ],
)
async def test_without_an_answer_it_is_an_error(text: str, message: str) -> None:
    process = program(READY + text)
    seconds = 0.2 if "longer" in message else 60
    try:
        with pytest.raises(RulesExceeded, match=message):
            await process.ask(BODY, seconds)
    finally:
        process.close()
    assert not is_alive(process)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pass", "the process for rules does not start"),
        ("import os; os.write(1, b'\\0\\0\\0\\1\\1')", "answers in another form"),
        ("import os; os.write(1, b'\\0\\0\\0\\3\\x82\\0\\x80')", "says nothing of being confined"),
    ],
)
async def test_one_that_is_not_confined_is_asked_nothing(text: str, message: str) -> None:
    process = program(text)
    try:
        with pytest.raises((RulesNotConfined, RulesExceeded), match=message):
            await process.ask(BODY, 60)
    finally:
        process.close()


async def test_it_says_itself_why_it_is_not_confined() -> None:
    first = requests.frame(encode([5, "no seccomp", "another kernel"]))
    process = program(f"import os; os.write(1, {first!r})")
    try:
        with pytest.raises(RulesNotConfined, match="no seccomp") as caught:
            await process.ask(BODY, 60)
        assert caught.value.hint == "another kernel"
    finally:
        process.close()


async def test_one_that_does_not_start_in_time_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rule_runner, "START", 0.05)
    process = program("import time; time.sleep(60)")
    try:
        with pytest.raises(RulesNotConfined, match="does not start"):
            await process.ask(BODY, 60)
    finally:
        process.close()


def test_a_program_that_is_missing_is_told() -> None:
    with pytest.raises(RulesNotConfined, match=r"does not start: .*No such file"):
        RuleProcess(["/none/python"])


async def test_it_has_no_descriptor_and_no_environment_of_this_process() -> None:
    held = os.open("/etc/passwd", os.O_RDONLY)
    os.set_inheritable(held, True)
    text = (
        "own = sorted(os.listdir('/proc/self/fd'), key=int)\n"
        "said = repr((own, dict(os.environ), os.getcwd())).encode()\n"
        "os.write(1, len(said).to_bytes(4, 'big') + said); time.sleep(60)"
    )
    process = program(READY + text)
    try:
        own, environment, directory = eval(await process.ask(BODY, 60))
    finally:
        process.close()
        os.close(held)
    assert own[:3] == ["0", "1", "2"]
    assert len(own) == 4  # and the one with which it looks
    assert "HOME" not in environment
    assert directory == "/"


def children(pid: int) -> list[int]:
    return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


async def test_what_works_for_a_request_ends_with_it() -> None:
    loops = '<xsl:for-each select="//a">' * 4 + "</xsl:for-each>" * 4
    endless = request(sheet(loops), b"<r>" + b"<a/>" * 500 + b"</r>")
    process = RuleProcess()
    asked = asyncio.ensure_future(process.ask(requests.write_request(endless), 60))
    try:
        await until(lambda: bool(children(process.worker.pid)))
        (worker,) = children(process.worker.pid)
    finally:
        asked.cancel()
        await asyncio.gather(asked, return_exceptions=True)
        process.close()
    await until(lambda: not Path(f"/proc/{worker}").exists())


async def test_nothing_is_left_of_one_that_is_cancelled_at_any_moment() -> None:
    """Nor a warning of a process, socket or transport that nobody closed."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for steps in range(6):
            process = RuleProcess()
            task = asyncio.ensure_future(process.ask(BODY, 60))
            for _ in range(steps):
                await asyncio.sleep(0.02)
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)
            process.close()
            assert not is_alive(process)
        gc.collect()
