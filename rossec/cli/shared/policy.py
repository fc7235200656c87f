"""The policy that a command works on."""

from pathlib import Path

from rossec.authority.policyfile import PolicyFile, place
from rossec.cli.shared.context import Environment


def read_policy(environment: Environment, given: Path | None, *, signs: bool = False) -> PolicyFile:
    """The policy a command is about.

    Args:
        environment: with the home.
        given: another file than the one in force.
        signs: grants are signed by it, so nobody else may be able to write it.

    Raises:
        ConfigurationError, PolicyRefused: there is none, or it has mistakes.
        PathRefused: somebody else could have written what is, or is to be, in force.
    """
    return PolicyFile.read(place(environment.home, given), own=signs or given is None)
