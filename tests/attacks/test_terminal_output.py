"""What peers, files, policies and arguments hold reaches a terminal as text, from every command."""

import ast
import asyncio
import json
import re
import time
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

import click
import pytest

import rossec.cli
from rossec import terminal
from rossec.authority.home import AuthorityHome
from rossec.cli.main import rossec as program
from rossec.cli.shared.context import LazyCommand
from tests.support.commands import PASSPHRASE, Said, Shell

pytestmark = [pytest.mark.attack("terminal-output"), pytest.mark.timeout(600)]

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e\x7f\udc80\rrossec: ok\nrossec: ok"
_STEERS = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_FORGED = re.compile("^rossec: ok", re.MULTILINE)
_PRINTS = {("sys", "stdout"), ("sys", "stderr"), ("click", "echo"), ("click", "secho")}
# Who writes by itself: its own texts only, with what is not its own through `printable`.
_OWN_TEXTS = {"shared/options.py", "shared/context.py", "node/enroll.py", "main.py", "demo.py"}


def check(text: str) -> None:
    found = _STEERS.search(text) or _FORGED.search(text)
    assert found is None, ascii(text)


def leaves(command: click.Command, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every command that does something."""
    loaded = command.load() if isinstance(command, LazyCommand) else command
    if not isinstance(loaded, click.Group):
        yield path
        return
    for name, below in loaded.commands.items():
        yield from leaves(below, (*path, name))


def command_of(path: tuple[str, ...]) -> click.Command:
    found: click.Command = program
    for name in path:
        assert isinstance(found, click.Group)
        below = found.commands[name]
        found = below.load() if isinstance(below, LazyCommand) else below
    return found


def hostile_arguments(command: click.Command) -> Iterator[list[str]]:
    """The hostile value as every argument, and as each option that takes a value."""
    given = [HOSTILE for each in command.params if isinstance(each, click.Argument)]
    if given:
        yield given
        yield [*given, "--json"]
    for each in command.params:
        if isinstance(each, click.Option) and not each.is_flag:
            yield [*given, each.opts[0], HOSTILE]
    yield [*given, f"--{HOSTILE}"]


def test_no_command_prints_but_through_the_functions_that_escape() -> None:
    root = Path(rossec.cli.__file__).parent
    found = set()
    for path in root.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Call(func=ast.Name(id="print")):
                    found.add(str(path.relative_to(root)))
                case ast.Attribute(value=ast.Name(id=module), attr=name):
                    if (module, name) in _PRINTS:
                        found.add(str(path.relative_to(root)))
                case _:
                    pass
    assert found <= _OWN_TEXTS


def test_only_codes_are_printed_as_pictures() -> None:
    for path in Path(rossec.cli.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            match node:
                case ast.Call(func=ast.Name(id="say_picture" | "note_picture"), args=[ast.Call() as made]):
                    assert ast.unparse(made.func) == "qr.terminal"
                case ast.Call(func=ast.Name(id="say_picture" | "note_picture")):
                    pytest.fail(f"{path}: a picture that is not qr.terminal's")
                case _:
                    pass


def test_every_function_that_prints_escapes(capsys: pytest.CaptureFixture[str]) -> None:
    terminal.say(HOSTILE)
    terminal.note(HOSTILE)
    terminal.fail(HOSTILE, HOSTILE)
    terminal.say_json({HOSTILE: [HOSTILE]})
    terminal.say_block(HOSTILE.replace("\nrossec: ok", "\nsecond"))
    terminal.say_secret(HOSTILE.replace("\nrossec: ok", "\nsecond"))
    out, err = capsys.readouterr()
    check(out)
    check(err)
    assert out.splitlines()[3] == "second"  # a block has lines


def test_json_has_no_half_of_a_surrogate_pair() -> None:
    text = terminal.to_json({"a\udc80": ["\ud83d", ("\x7f", {"b": "\U0001f600"})]})
    check(text)
    read = json.loads(text)
    assert read == {"a\\udc80": ["\\ud83d", ["\x7f", {"b": "\U0001f600"}]]}
    json.dumps(read, ensure_ascii=False).encode()  # no half of a pair is left


@pytest.fixture
def shell(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Shell:
    def nobody(*_: object, **__: object) -> str:
        raise EOFError

    monkeypatch.setattr("click.termui.visible_prompt_func", nobody)
    monkeypatch.setattr("click.termui.hidden_prompt_func", nobody)
    run = asyncio.run

    def run_for_a_moment(main: Coroutine[Any, Any, Any], **options: Any) -> Any:
        async def bounded() -> Any:
            try:
                async with asyncio.timeout(0.5):
                    return await main
            except TimeoutError:
                raise KeyboardInterrupt from None  # as a person does with what serves

        return run(bounded(), **options)

    monkeypatch.chdir(tmp_path)  # some take it for the name of a file to write
    monkeypatch.setattr(asyncio, "run", run_for_a_moment)
    monkeypatch.setattr(time, "sleep", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
    shell = Shell(tmp_path / "home", capsys)
    AuthorityHome.create(shell.root, "home", PASSPHRASE, int(time.time()))
    shell.environ |= {"ROS_MASTER_URI": "http://127.0.0.1:9"}
    return shell


def check_said(said: Said) -> None:
    check(said.out)
    check(said.err)


# These become another program, which has no place in this process.
_OTHER_PROGRAMS = {("run",), ("sidecar",), ("demo",), ("border", "demo")}


@pytest.mark.parametrize("path", sorted({*leaves(program)} - _OTHER_PROGRAMS), ids=" ".join)
def test_an_argument_of_any_command_is_shown_as_text(shell: Shell, path: tuple[str, ...]) -> None:
    """What cannot be the value of an argument is named in the refusal, never as it is."""
    for arguments in hostile_arguments(command_of(path)):
        check_said(shell(*path, *arguments))


def test_a_file_of_any_name_is_signed_and_shown_as_text(shell: Shell, tmp_path: Path) -> None:
    assert shell("node", "request", "/robot").code == 0
    request = tmp_path / f"{HOSTILE.replace('/', '')}.csr"
    (shell.node("/robot") / "node.csr").rename(request)
    said = shell.unlocked("ca", "sign", str(request), "--yes")
    assert said.code == 0, said
    check_said(said)
    request.with_suffix(".pem").unlink()
    request.write_bytes(request.read_bytes())
    said = shell.unlocked("ca", "sign", str(request), "--yes", "--json")
    check_said(said)
    json.loads(said.out)


POLICY = """rossec: 1
robot: r
rules:
  - {{id: a, why: {why}, who: /heating, allow: {{subscribe: [/pose]}}}}
"""


def test_the_reason_of_a_rule_is_shown_as_text(shell: Shell, tmp_path: Path) -> None:
    policy = tmp_path / "policy.yaml"
    why = json.dumps("\x1b]0;x\x07\x9b31m\u202e\rrossec: ok\nrossec: ok")
    policy.write_text(POLICY.format(why=why))
    for words in (("explain", "/heating", "subscribe", "/pose"), ("policy", "check")):
        place = ("--policy", str(policy)) if words[0] == "explain" else (str(policy),)
        for how in ((), ("--json",)):
            said = shell(*words, *place, *how)
            check_said(said)
            if how and said.code == 0:
                json.loads(said.out)
