"""The policy that a command works on."""

from pathlib import Path

from rossec.authority.policyfile import PolicyFile, place
from rossec.cli.shared.context import Environment


def read_policy(environment: Environment, given: Path | None, *, signs: bool = False) -> PolicyFile:
    """The policy a command works on.

    Args:
        environment: has ROSSEC_HOME.
        given: a file other than the policy in force.
        signs: grants are signed by it, so no other user may be able to write it.

    Raises:
        ConfigurationError, PolicyRefused: it is missing or invalid.
        PathRefused: another user can write the policy in force, or one that signs.
    """
    return PolicyFile.read(place(environment.home, given), own=signs or given is None)
