"""`rossec policy check | lint`: the mistakes in a policy, and advice on it."""

from pathlib import Path

import click

from grants.errors import PolicyRefused
from grants.policy.assertion_check import check_tests
from grants.policy.basics import is_basics
from grants.policy.lint import lint as advise
from grants.policy.mistakes import Mistake
from grants.policy.read import mistakes_in
from rossec.authority.policyfile import PolicyFile, layout_of, place
from rossec.cli.policy.apply_report import count
from rossec.cli.shared.context import Environment, pass_environment
from rossec.terminal import fail, say, say_json

_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


_JSON = click.option("--json", "as_json", is_flag=True, help="one line of JSON")


@click.command()
@click.argument("file", required=False, type=_FILE)
@_JSON
@pass_environment
def check(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Check the policy in FILE: its form, its words, conditions and filters, and its tests."""
    path = place(environment.home, file)
    try:
        read = PolicyFile.read(path)
    except PolicyRefused as error:
        _print_mistakes(mistakes_in(error), as_json=as_json)
        raise PolicyRefused(f"{path} is not a policy", "correct it, and check again") from None
    outcomes = check_tests(read.policy, layout_of)
    failures = [each for each in outcomes if not each]
    if failures:
        found = (Mistake(x.line, 1, x.failure, x.needed, str(path)) for x in failures)
        _print_mistakes(tuple(found), as_json=as_json)
        message = f"{len(failures)} of {len(outcomes)} assertions of {path} do not hold"
        raise PolicyRefused(message, "correct the rules, or what the tests say")
    if as_json:
        say_json([])
        return
    basics = any(map(is_basics, read.policy.rules))
    rules = [f"rules: {len(read.policy.rules) - basics}", *(["basics"] if basics else [])]
    tests = [f"tests that hold: {len(read.policy.tests)}"] if read.policy.tests else []
    say(f"{path} is right; {', '.join([*rules, *tests])}")


@click.command()
@click.argument("file", required=False, type=_FILE)
@_JSON
@pass_environment
def lint(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Warn of what the policy in FILE allows unwisely, such as a hidden value that still leaks."""
    read = PolicyFile.read(place(environment.home, file))
    found = advise(read.policy, layout_of)
    if as_json:
        say_json([item.as_json() for item in found])
        return
    for item in found:
        say(f"{read.path}:{item.line}: {item.message} [{item.code}]")
        say(f"  {item.hint}")
    say(remarks(len(found)))


def remarks(number: int) -> str:
    """`1 remark`, `2 remarks`, `nothing to remark`."""
    return count(number, "remark") if number else "nothing to remark"


def _print_mistakes(found: tuple[Mistake, ...], *, as_json: bool) -> None:
    if as_json:
        say_json([vars(item) for item in found])
        return
    for item in found:
        fail(str(item), item.hint)
