"""Names asked for of rules, by several callers at a time."""

import asyncio
import os
import signal
import sys

import pytest

from ca.encoding import encode
from rossec.errors import (
    MetadataRefused,
    NameUndefined,
    ProposedNameRefused,
    RossecError,
    RulesExceeded,
    RulesNotConfined,
    RulesRefused,
)
from rossec.naming import requests, rule_runner
from rossec.naming.requests import MAX_INPUT, NameKind
from rossec.naming.rule_runner import RuleProcess, RuleRunner, require_extra
from tests.rossec.naming.stylesheets import NODE, PHONE, RULES, gives, sheet
from tests.support.witness import until

NAME = "/smartphones/schneider/htc_desire"
ENDLESS = sheet(
    '<xsl:for-each select="//a"><xsl:for-each select="//a"><xsl:for-each select="//a">'
    '<xsl:if test="count(//a[. = current()]) = 0">b</xsl:if>'
    "</xsl:for-each></xsl:for-each></xsl:for-each>"
)


class Started:
    """Processes, counted."""

    def __init__(self) -> None:
        self.processes: list[RuleProcess] = []

    def __call__(self) -> RuleProcess:
        self.processes.append(RuleProcess())
        return self.processes[-1]

    @property
    def alive(self) -> int:
        found = 0
        for process in self.processes:
            try:
                os.kill(process.worker.pid, 0)
            except ProcessLookupError:
                continue
            found += 1
        return found


def program(text: str) -> RuleProcess:
    return RuleProcess([sys.executable, "-I", "-c", text])


async def test_the_names_of_the_thesis() -> None:
    async with RuleRunner(RULES) as rules:
        assert await rules.name(PHONE) == NAME
        assert await rules.name(PHONE, NameKind.TOPIC, "accelerometer") == (
            "/smartphones/schneider/htc_desire/sensors/accelerometer"
        )
        assert await rules.name(PHONE, NameKind.TOPIC, "temperature") == (
            "/building1/room3/sensors/temperature"
        )


async def test_a_process_is_kept_for_the_next_request_and_ended_at_the_end() -> None:
    started = Started()
    async with RuleRunner(RULES, start=started) as rules:
        for _ in range(3):
            assert await rules.name(PHONE) == NAME
        assert started.alive == len(started.processes) == 1
    assert started.alive == 0


async def test_as_many_processes_as_allowed_answer_at_the_same_time() -> None:
    started = Started()
    async with RuleRunner(RULES, children=2, start=started) as rules:
        assert set(await asyncio.gather(*(rules.name(PHONE) for _ in range(6)))) == {NAME}
        assert len(started.processes) == 2


async def test_several_names_are_answered_in_order_each_with_its_error() -> None:
    async with RuleRunner(RULES) as rules:
        asked = [(NameKind.TOPIC, "none"), NODE, (NameKind.SERVICE, "accelerometer")]
        first, second, third = await rules.names(PHONE, asked)
        assert second == NAME
        assert isinstance(first, NameUndefined)
        assert isinstance(third, NameUndefined)
        assert await rules.names(PHONE, []) == []
        with pytest.raises(NameUndefined, match="no name for the topic 'none'"):
            await rules.name(PHONE, NameKind.TOPIC, "none")


async def test_what_is_no_name_or_reserved_does_not_leave() -> None:
    async with RuleRunner(gives("/node/group")) as rules:
        for group in ("/a-b", "", "/a b", "a", "/ä", "/remote/a", "/master", "/a/"):
            document = f"<node><group>{group}</group></node>".encode()
            with pytest.raises(ProposedNameRefused):
                await rules.name(document)
        assert await rules.name(b"<node><group>/a</group></node>") == "/a"


async def test_the_defaults_of_the_thesis_leave_where_they_are_asked_for() -> None:
    async with RuleRunner(RULES, thesis_defaults=True) as rules:
        assert await rules.name(b"<node/>") == "/unknown-group/unknown-node"
    async with RuleRunner(RULES) as rules:
        assert await rules.name(b"<node/>") == "/unknown_group/unknown_node"


@pytest.mark.parametrize(
    ("rules", "error"),
    [
        (b"", RulesRefused),
        (b"<!DOCTYPE a>", RulesRefused),
        (b"a" * (MAX_INPUT + 1), RulesRefused),
        (sheet("<xsl:import/>"), RulesRefused),
        (sheet("<xsl:value-of select='+'/>"), RulesRefused),
    ],
)
async def test_rules_are_refused_at_the_start(rules: bytes, error: type[RossecError]) -> None:
    started = Started()
    with pytest.raises(error):
        async with RuleRunner(rules, start=started):
            pass
    assert started.alive == 0


async def test_what_is_asked_is_checked_before() -> None:
    async with RuleRunner(RULES) as rules:
        for document in (b"", b"<!DOCTYPE a>", b"a" * (MAX_INPUT + 1)):
            with pytest.raises(MetadataRefused):
                await rules.name(document)
        with pytest.raises(MetadataRefused):
            await rules.name(PHONE, NameKind.TOPIC, "a\0b")


async def test_a_process_that_failed_is_replaced() -> None:
    started = Started()
    async with RuleRunner(ENDLESS, seconds=0.3, start=started) as rules:
        heavy = b"<r>" + b"<a/>" * 3000 + b"</r>"
        with pytest.raises(RulesExceeded, match=r"took longer than 0\.3 s"):
            await rules.name(heavy)
        with pytest.raises(NameUndefined):
            await rules.name(b"<r/>")
        assert (len(started.processes), started.alive) == (2, 1)
    assert started.alive == 0


async def test_one_that_ended_while_nobody_asked_is_replaced() -> None:
    """By the kernel for want of memory, for example: no caller has an error for it."""
    started = Started()
    async with RuleRunner(RULES, children=2, start=started) as rules:
        await asyncio.gather(rules.name(PHONE), rules.name(PHONE))
        for process in started.processes:
            os.kill(process.worker.pid, signal.SIGKILL)
        await until(lambda: all(process.worker.has_ended for process in started.processes))
        assert await rules.name(PHONE) == NAME
    assert (len(started.processes), started.alive) == (3, 0)


async def test_a_caller_that_goes_away_leaves_no_process() -> None:
    started = Started()
    async with RuleRunner(ENDLESS, start=started) as rules:
        task = asyncio.ensure_future(rules.name(b"<r>" + b"<a/>" * 3000 + b"</r>"))
        await asyncio.sleep(0.2)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert started.alive == 0
        with pytest.raises(NameUndefined):
            await rules.name(b"<r/>")
    assert started.alive == 0


async def test_a_runner_that_is_cancelled_while_it_starts_leaves_no_process() -> None:
    started = Started()

    async def run() -> None:
        async with RuleRunner(RULES, start=started):
            await asyncio.sleep(60)

    for pause in (0, 0.01, 0.05, 0.3):
        task = asyncio.ensure_future(run())
        await asyncio.sleep(pause)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert started.alive == 0


async def test_a_request_that_ends_after_the_runner_ends_its_process() -> None:
    started = Started()
    async with RuleRunner(RULES, start=started) as rules:
        task = asyncio.ensure_future(rules.name(PHONE))
        waiting = asyncio.ensure_future(rules.name(PHONE))
        await asyncio.sleep(0)
        rules.close()
        assert await task == NAME
        with pytest.raises(RulesExceeded, match="have ended"):
            await waiting
    assert (len(started.processes), started.alive) == (1, 0)


async def test_a_process_that_is_not_confined_gives_no_names() -> None:
    text = f"import os; os.write(1, {requests.frame(encode([5, 'no seccomp', '']))!r})"
    with pytest.raises(RulesNotConfined, match="no seccomp"):
        async with RuleRunner(RULES, start=lambda: program(text)):
            pass


async def test_a_process_that_was_taken_over_gives_no_other_names_than_rules() -> None:
    """It may lie about a name; it cannot make one that is none, or a reserved one."""
    said = [requests.READY, encode([0, []]), encode([0, [[0, "/master"]]])]
    text = (
        "import os\n"
        f"for said in {said!r}:\n"
        "    os.write(1, len(said).to_bytes(4, 'big') + said)\n"
        "os.read(0, 9); import time; time.sleep(60)"
    )
    async with RuleRunner(RULES, start=lambda: program(text)) as rules:
        with pytest.raises(ProposedNameRefused, match="reserved"):
            await rules.name(PHONE)


def test_without_the_library_it_says_what_to_install() -> None:
    require_extra()
    with pytest.raises(RossecError, match="need lxml2, which is not") as caught:
        require_extra("lxml2")
    assert caught.value.hint == "install the extra: pip install 'rossec[names]'"
    assert rule_runner.LIBRARY == "lxml"
