"""`rossec policy test`: what must stay true of a policy."""

from pathlib import Path

import click

from grants.errors import PolicyRefused
from grants.policy.assertion_check import Outcome, check_tests
from rossec.authority.policyfile import PolicyFile, layout_of, place
from rossec.cli.shared.context import Environment, pass_environment
from rossec.terminal import fail, say, say_json

_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@click.command()
@click.argument("file", required=False, type=_FILE)
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def test(environment: Environment, file: Path | None, as_json: bool) -> None:
    """Run the tests in the policy FILE: what must stay true of it.

    Each failure says which rule decided, and what would be needed. `rossec policy apply` refuses a
    policy of which one fails.
    """
    path = place(environment.home, file)
    outcomes = check_tests(PolicyFile.read(path).policy, layout_of)
    if as_json:
        say_json([_row(each) for each in outcomes])
    failures = [each for each in outcomes if not each]
    for each in failures if not as_json else ():
        fail(f"{path}:{each.line}: {each.failure}", each.needed)
    if failures:
        raise PolicyRefused(
            f"{len(failures)} of {len(outcomes)} assertions of {path} do not hold",
            "correct the rules, or what the tests say",
        )
    if not as_json:
        say(f"assertions that hold: {len(outcomes)}" if outcomes else f"{path} has no tests")


def _row(outcome: Outcome) -> dict[str, object]:
    return {
        "line": outcome.line, "node": outcome.node, "says": outcome.says, "holds": bool(outcome),
        "failure": outcome.failure, "rules": list(outcome.rules), "needed": outcome.needed,
    }  # fmt: skip
