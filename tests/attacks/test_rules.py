"""Rules and metadata that take too much, reach out, or name what is not theirs.

The rules of each attack give honest metadata an honest name, and somebody asks for it all the
while: whatever the attack does, the others are answered. The process with the limits is the real
one; where these tests run as root, so does the attacker.
"""

import asyncio
import os
import resource
import socket
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from rossec.errors import MetadataRefused, NameUndefined, ProposedNameRefused, RulesExceeded, RulesRefused
from rossec.naming import child, requests
from rossec.naming.requests import MAX_INPUT, NameKind
from rossec.naming.rule_runner import RuleProcess, RuleRunner
from tests.rossec.naming.stylesheets import PHONE, RULES, request, sheet
from tests.support.witness import until

STRINGS = 'xmlns:str="http://exslt.org/strings"'
HONEST = b"<node><name>lamp</name></node>"
NAME = "/honest/lamp"
MANY = "<a>b</a>" * 400


def rules_with(body: str, *, top: str = "") -> bytes:
    """Rules that do `body` for evil metadata, and give others an honest name."""
    return sheet(
        f'<xsl:choose><xsl:when test="/node/evil">{body}</xsl:when><xsl:otherwise>'
        '<name>/honest/<xsl:value-of select="/node/name"/></name></xsl:otherwise></xsl:choose>',
        attributes=STRINGS,
        top=top,
    )


def evil(content: str = "") -> bytes:
    return f"<node><evil/>{content}</node>".encode()


@asynccontextmanager
async def answered_meanwhile(rules: bytes) -> AsyncIterator[RuleRunner]:
    """A runner whose honest caller is answered before, while and after the attack runs."""
    answers: list[str] = []

    async def ask() -> None:
        while True:
            answers.append(await runner.name(HONEST))
            await asyncio.sleep(0.01)

    async with RuleRunner(rules, children=2) as runner:
        asking = asyncio.ensure_future(ask())
        try:
            await until(lambda: len(answers) > 2)
            yield runner
            before = len(answers)
            await until(lambda: len(answers) > before + 2)
        finally:
            asking.cancel()
            ended = await asyncio.gather(asking, return_exceptions=True)
    assert isinstance(ended[0], asyncio.CancelledError), ended
    assert set(answers) == {NAME}


def loops(depth: int) -> str:
    inside = '<xsl:if test="count(//a[. = current()]) = 0">b</xsl:if>'
    for _ in range(depth):
        inside = f'<xsl:for-each select="//a">{inside}</xsl:for-each>'
    return inside


def doubling(times: int) -> str:
    return "<xsl:variable name='v0' select=\"'0123456789abcdef'\"/>" + "".join(
        f"<xsl:variable name='v{n + 1}' select='concat($v{n}, $v{n})'/>" for n in range(times)
    )


RECURSION = (
    '<xsl:template name="again"><xsl:call-template name="again"/></xsl:template>'
    '<xsl:template match="evil"><xsl:apply-templates select="."/></xsl:template>'
    '<xsl:template name="growing"><xsl:param name="p"/><xsl:call-template name="growing">'
    '<xsl:with-param name="p" select="concat($p, $p, 1)"/></xsl:call-template></xsl:template>'
    '<xsl:key name="k" match="a" use="."/><xsl:key name="all" match="a" use="//a"/>'
)


@pytest.mark.attack("rules-exhaustion")
@pytest.mark.parametrize(
    ("body", "content"),
    [
        (loops(4), MANY),
        (f'{doubling(40)}<name><xsl:value-of select="$v40"/></name>', ""),
        (f'{doubling(16)}<name><xsl:value-of select="$v16"/></name>', ""),
        ('<xsl:call-template name="again"/>', ""),
        ('<xsl:apply-templates select="node/evil"/>', ""),
        ('<xsl:call-template name="growing"/>', ""),
        ("<name><xsl:value-of select='str:padding(999999999, \"a\")'/></name>", ""),
        (f"{doubling(20)}<xsl:value-of select='count(str:tokenize($v20, \"0\"))'/>", ""),
        (f"{doubling(18)}<xsl:value-of select='str:replace($v18, \"0\", $v18)'/>", ""),
        (
            "<xsl:for-each select='//a'>" + loops(2) + "<xsl:value-of select=\"count(key('k', //a)/"
            "following::a[key('k', .)]/preceding::a)\"/></xsl:for-each>",
            MANY,
        ),
        ("<xsl:value-of select=\"count(key('all', //a)[key('all', //a)])\"/>" + loops(3), MANY),
        ("<xsl:copy-of select='//*[//*[//*[//*[. = 1]]]]'/>", MANY),
        ("<xsl:number value='999999999999' format='i'/><xsl:number value='1e300' format='a'/>", ""),
        (loops(1) + "<name>" + "<xsl:copy-of select='//a'/>" * 50 + "</name>", MANY),
    ],
    ids=[
        "nested loops",
        "endless doubling",
        "a megabyte for a name",
        "endless recursion",
        "endless templates",
        "growing recursion",
        "padding",
        "tokens",
        "replacement",
        "keys",
        "keys of all",
        "predicates",
        "roman numbers",
        "copies",
    ],
)
async def test_rules_that_take_too_much_are_ended(body: str, content: str) -> None:
    async with answered_meanwhile(rules_with(body, top=RECURSION)) as runner:
        with pytest.raises((RulesExceeded, RulesRefused, NameUndefined, ProposedNameRefused)):
            await runner.name(evil(content))


@pytest.mark.attack("rules-exhaustion")
@pytest.mark.parametrize(
    "document",
    [
        b"<node>" + b"a" * MAX_INPUT,
        b"<a>" * 30_000,
        b"<a>" * 30_000 + b"</a>" * 30_000,
        b"<node " + b" ".join(b'a%d="b"' % n for n in range(20_000)) + b"/>",
        b"<node " + b"a" * 100_000 + b'="b"/>',
        b"<node>&#x10FFFF;" + b"&amp;" * 50_000,
    ],
    ids=["too long", "deep", "deep and closed", "attributes", "a long attribute", "not closed"],
)
async def test_metadata_that_are_large_or_deep_are_refused_or_named(document: bytes) -> None:
    async with answered_meanwhile(rules_with("<name>/evil</name>")) as runner:
        with pytest.raises((MetadataRefused, ProposedNameRefused, RulesExceeded)):
            await runner.name(document)


LAUGHS = b"".join(
    b'<!ENTITY l%d "%s">' % (n + 1, b"&l%d;" % n * 10) for n in range(9)
)  # each ten times the one before
EXTERNAL = b'<!DOCTYPE node [<!ENTITY e SYSTEM "file:///etc/passwd">]><node><name>&e;</name></node>'


@pytest.mark.attack("rules-documents")
@pytest.mark.parametrize(
    "document",
    [
        b'<!DOCTYPE node [<!ENTITY l0 "a">' + LAUGHS + b"]><node><name>&l9;</name></node>",
        EXTERNAL,
        EXTERNAL.decode().encode("utf-16"),
        b'<?xml version="1.0" encoding="utf-7"?>+ADwAIQ-DOCTYPE node+AD4-<node/>',
        '<?xml version="1.0" encoding="EBCDIC-CP-US"?><!DOCTYPE a><node/>'.encode("cp037"),
        b'<!DOCTYPE node SYSTEM "http://127.0.0.1:9/a.dtd"><node/>',
        b"<node><name>&l0;</name></node>",
        b'<node xmlns:xi="http://www.w3.org/2001/XInclude"><xi:include href="/etc/passwd"/></node>',
    ],
    ids=["laughs", "external", "utf-16", "utf-7", "ebcdic", "dtd", "undeclared", "xinclude"],
)
async def test_entities_and_other_documents_are_not_read(document: bytes) -> None:
    async with answered_meanwhile(rules_with("<name><xsl:value-of select='/node'/></name>")) as to:
        with pytest.raises((MetadataRefused, ProposedNameRefused)) as caught:
            await to.name(document)
        assert "root" not in str(caught.value)


@pytest.mark.attack("rules-documents")
@pytest.mark.parametrize(
    ("body", "top"),
    [
        ("<xsl:copy-of select=\"document('FILE')\"/>", ""),
        ("<xsl:copy-of select=\"document('')\"/>", ""),
        ("<a b=\"{document('FILE')}\"/>", ""),
        ('<xsl:copy-of select="document(/node/evil)"/>', ""),
        ("<xsl:copy-of select=\"document('http://127.0.0.1:9/')\"/>", ""),
        ("", '<xsl:import href="FILE"/>'),
        ("", '<xsl:include href="FILE"/>'),
        ('<e:document xmlns:e="http://exslt.org/common" href="FILE">a</e:document>', ""),
        ('<xsl:document href="FILE">a</xsl:document>', ""),
        ("<xsl:value-of select=\"d:evaluate('1')\" xmlns:d='http://exslt.org/dynamic'/>", ""),
        ("<xsl:value-of select='generate-id()'/>", ""),
        ('<x:script xmlns:x="urn:schemas-microsoft-com:xslt">a</x:script>', ""),
        ("<parameter name='a' path=\"document('FILE')\"/>", ""),
        ("", "<xsl:variable name='a' select=\"document('FILE')\"/>"),
    ],
)
async def test_rules_that_reach_out_are_refused(body: str, top: str, tmp_path: Path) -> None:
    secret = tmp_path / "secret.xml"
    rules = rules_with(body, top=top).replace(b"FILE", str(secret).encode())
    async with answered_meanwhile(rules_with("")):
        with pytest.raises(RulesRefused, match=r"^line \d+: rules may not use"):
            async with RuleRunner(rules):
                pass
    assert not secret.exists()


@pytest.mark.attack("rules-names")
@pytest.mark.parametrize(
    "value",
    [
        "../master",
        "..",
        "/",
        "//master",
        "a/../../master",
        "~a",
        "$(find a)",
        "a b",
        "a\tb",
        "a-b",
        "1a",
        "é",
        "\uff41",
        "\u0430",
        "a\u200b",
        "a\x7f",
        "master\0",
        "a" * 300,
        "'or'1'='1",
        "document('/etc/passwd')",
        "{1}",
        "%2e",
        "\u202e",
    ],
)
async def test_a_name_that_is_none_does_not_leave(value: str) -> None:
    rules = rules_with("<name>/<xsl:value-of select='/node/name'/></name>")
    async with answered_meanwhile(rules) as runner:
        with pytest.raises((ProposedNameRefused, MetadataRefused)):
            await runner.name(evil(f"<name>{value}</name>"))


@pytest.mark.attack("rules-names")
@pytest.mark.parametrize("value", ["master", "ca", "relay/a", "remote/home/a", "rosout", "clock"])
async def test_a_name_that_others_trust_does_not_leave(value: str) -> None:
    document = f"<node><topic><name>a</name><location>{value}</location></topic></node>".encode()
    async with RuleRunner(RULES) as runner:
        with pytest.raises(ProposedNameRefused, match="which is reserved"):
            await runner.name(document, NameKind.TOPIC, "a")


@pytest.mark.attack("rules-names")
@pytest.mark.parametrize("which", ["' or true() or '", '"', "']|//*['", "a\nb", "\0", "a" * 256])
async def test_what_is_asked_for_is_text_and_no_expression(which: str) -> None:
    async with RuleRunner(RULES) as runner:
        with pytest.raises((NameUndefined, MetadataRefused)):
            await runner.name(PHONE, NameKind.TOPIC, which)


def taken_over(monkeypatch: pytest.MonkeyPatch, action: Callable[[], object]) -> requests.Result | bytes:
    """What comes of a request whose process does what an attacker likes, once it is restricted."""

    def answered(_: bytes) -> bytes:
        try:
            action()
        except (OSError, ValueError):  # of setrlimit: not allowed
            return requests.write_names(["/refused"])
        return requests.write_names(["/succeeded"])

    monkeypatch.setattr(child, "_answered", answered)
    body = requests.write_request(request(RULES))
    return requests.read_names(bytes(child.ask(bytearray(body))), 1)[0]


def fork_bomb() -> None:
    while True:
        os.fork()


@pytest.mark.attack("rules-takeover")
@pytest.mark.parametrize(
    "action",
    [
        fork_bomb,
        lambda: os.execv("/bin/true", ["/bin/true"]),
        lambda: os.kill(os.getppid(), 9),
        lambda: os.kill(1, 0),
        lambda: os.write(1, b"an answer to the next caller"),
        lambda: os.read(0, 1),
        lambda: os.open("/etc/passwd", os.O_RDONLY),
        lambda: os.open("/tmp/made-by-rules", os.O_WRONLY | os.O_CREAT),
        socket.socket,
        lambda: resource.setrlimit(resource.RLIMIT_CPU, (99, 99)),
        lambda: os.setuid(0),
        lambda: os.chroot("/"),
    ],
    ids=[
        "fork",
        "exec",
        "kill",
        "kill init",
        "write for others",
        "read for others",
        "read a file",
        "write a file",
        "socket",
        "limits",
        "setuid",
        "chroot",
    ],
)
def test_a_process_that_was_taken_over_reaches_nothing(
    monkeypatch: pytest.MonkeyPatch, action: Callable[[], object]
) -> None:
    assert taken_over(monkeypatch, action) == "/refused"
    assert not Path("/tmp/made-by-rules").exists()


@pytest.mark.attack("rules-takeover")
def test_one_that_takes_memory_or_time_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    def memory() -> None:
        held = []
        while True:
            held.append(bytes(1 << 20))

    def time() -> None:
        while True:
            pass

    for action in (memory, time):
        with pytest.raises(RulesExceeded, match="more time or memory than allowed"):
            taken_over(monkeypatch, action)


@pytest.mark.attack("rules-takeover")
async def test_nothing_of_one_that_was_taken_over_is_there_for_the_next_caller() -> None:
    """It answers twice, and changes what is in its memory: neither reaches anybody."""
    program = (
        "from rossec.naming import child, requests\n"
        "honest = child._answered\n"
        "def answered(body):\n"
        "    child._answered = lambda _: requests.write_names(['/kept'])\n"
        "    return requests.write_names(['/lie']) * 2 if b'secret' in body else honest(body)\n"
        "child._answered = answered\n"
        "child.main()\n"
    )
    command = [sys.executable, "-I", "-c", program]
    async with RuleRunner(rules_with(""), start=lambda: RuleProcess(command)) as runner:
        for _ in range(3):
            assert await runner.name(HONEST) == NAME
            with pytest.raises(RulesExceeded, match="answers in another form"):
                await runner.name(evil("<name>secret</name>"))
