"""`rossec policy check | lint`: the mistakes in a policy, and advice on it."""

from pathlib import Path

import click

from grants.errors import PolicyRefused
from grants.policy.lint import Finding
from grants.policy.lint import lint as advise
from grants.policy.mistakes import Mistake
from grants.policy.read import mistakes_in
from rossec.authority.policyfile import PolicyFile, layout_of, place
from rossec.cli.shared.context import Environment, pass_environment
from rossec.terminal import fail, say, say_json

_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


_JSON = click.option("--json", "as_json", is_flag=True, help="one line of JSON")


@click.command()
@click.argument("file", required=False, type=_FILE)
@_JSON
@pass_environment
def check(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Check the policy in FILE: its form, its words, and every condition and filter in it."""
    path = place(environment.home, file)
    try:
        read = PolicyFile.read(path)
    except PolicyRefused as error:
        _print_mistakes(mistakes_in(error), as_json=as_json)
        raise PolicyRefused(f"{path} is not a policy", "correct it, and check again") from None
    if as_json:
        say_json([])
    else:
        say(f"{path} is right: {len(read.policy.rules)} rules")


@click.command()
@click.argument("file", required=False, type=_FILE)
@_JSON
@pass_environment
def lint(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Warn of what the policy in FILE allows unwisely, such as a hidden value that still leaks."""
    read = PolicyFile.read(place(environment.home, file))
    found = advise(read.policy, layout_of)
    if as_json:
        say_json([vars(item) for item in found])
        return
    for item in found:
        say(_format_finding(read.path, item))
    say(f"{len(found)} remarks" if found else "nothing to remark")


def _print_mistakes(found: tuple[Mistake, ...], *, as_json: bool) -> None:
    if as_json:
        say_json([vars(item) for item in found])
        return
    for item in found:
        fail(str(item), item.hint)


def _format_finding(path: Path, item: Finding) -> str:
    return f"{path}:{item.line}: {item.message}\n  {item.hint}"
