import shutil
import subprocess
from pathlib import Path

import click
import pytest

from rossec.cli.main import rossec
from rossec.cli.manual import escape, pages
from tests.rossec.cli.tables import all_commands

PAGES = pages(rossec, "1.2")


def test_each_noun_has_a_page() -> None:
    assert PAGES.keys() == {"rossec.1", *(f"rossec-{name}.1" for name in rossec.commands)}
    assert all(rf"rossec\-{escape(name)}" in PAGES["rossec.1"] for name in rossec.commands)


def test_each_command_and_each_option_is_in_a_page() -> None:
    for words, _, command in all_commands(rossec):
        page = PAGES["rossec.1" if len(words) == 1 else f"rossec-{words[1]}.1"]
        if not isinstance(command, click.Group) or command.invoke_without_command:
            assert rf"\fB{' '.join(map(escape, words))}\fR" in page
        for param in command.params:
            if isinstance(param, click.Option) and not param.hidden:
                assert all(escape(name) in page for name in param.opts), (words, param.opts)


def test_a_small_page_as_a_whole() -> None:
    @click.group(invoke_without_command=True)
    def ca() -> None:
        """Run it. More."""

    @ca.command()
    @click.argument("name")
    @click.option("--for", "time", help="how long", metavar="TIME")
    @click.option("--secret", hidden=True)
    def sign(**_values: object) -> None:
        """Sign NAME.

        Second.

        \b
          rossec ca sign /x
          .hidden
        """

    group = click.Group("rossec", commands=[ca], help="Security.")
    assert pages(group, "1.2")["rossec-ca.1"].splitlines() == [
        r'.TH "ROSSEC\-CA" 1 "" "rossec 1.2" "rossec manual"',
        '.SH "NAME"',
        r"rossec\-ca \- Run it",
        '.SH "SYNOPSIS"',
        r"\fBrossec ca\fR \fI[COMMAND] [ARGS]...\fR",
        ".br",
        r"\fBrossec ca sign\fR \fI[OPTIONS]\fR \fINAME\fR",
        '.SH "DESCRIPTION"',
        "Run it. More.",
        '.SH "COMMANDS"',
        '.SS "rossec ca sign"',
        "Sign NAME.",
        ".PP",
        "Second.",
        ".PP",
        ".RS 4",
        ".nf",
        "  rossec ca sign /x",
        r"  .hidden",
        ".fi",
        ".RE",
        ".TP",
        r"\fB\-\-for TIME\fR",
        "how long",
        '.SH "SEE ALSO"',
        r"\fBrossec\fR(1)",
    ]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("man")
    for name, text in PAGES.items():
        (folder / name).write_text(text)
    return [str(path) for path in sorted(Path(folder).iterdir())]


def test_mandoc_finds_nothing_wrong(written: list[str]) -> None:
    if shutil.which("mandoc") is None:
        pytest.skip("NOT RUN: no mandoc on this machine")
    command = ["mandoc", "-Tlint", "-W", "warning", *written]
    done = subprocess.run(command, text=True, capture_output=True, check=False)
    lines = [line for line in done.stdout.splitlines() if "missing date" not in line]
    assert lines == []  # there is no date on purpose: a build can be repeated


def test_groff_warns_of_nothing(written: list[str]) -> None:
    if shutil.which("groff") is None:
        pytest.skip("NOT RUN: no groff on this machine")
    command = ["groff", "-man", "-Kutf8", "-Tutf8", "-ww", "-z", *written]
    done = subprocess.run(command, text=True, capture_output=True, check=True)
    assert done.stderr == ""
