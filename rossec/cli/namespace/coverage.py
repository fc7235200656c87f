"""Whether grants in files, or a policy, give a node any right on a name that rules gave it.

Grants are read unverified: this is advice for who writes rules, and decides nothing. A rule that
pins a key counts as if the node had it, since its key is not known before it is enrolled.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

from ca.names import covers
from grants.errors import GrantError
from grants.model import Grant, Right
from grants.policy.decision import Decider
from grants.policy.model import Effect, Policy, Subject
from grants.reach import Reach
from grants.token import peek
from rossec.cli.shared.tokens import read_token
from rossec.errors import ConfigurationError
from rossec.naming.metadata import Kind

RIGHTS: Final = {
    Kind.TOPIC: Right.PUBLISH | Right.SUBSCRIBE,
    Kind.SERVICE: Right.PROVIDE | Right.CALL,
}
SUFFIX: Final = "*.grant"
_NO_KEY: Final = bytes(32)


class Coverage:
    """Grants and a policy, asked together: what either of them gives is covered.

    Args:
        grants: of any nodes; their subject says for whom.
        policy: None for no policy.
    """

    def __init__(self, grants: Iterable[Grant], policy: Policy | None) -> None:
        self._grants = tuple(grants)
        self._decider = None if policy is None else Decider(policy)
        rules = () if policy is None else policy.rules
        pinned = {who.key for rule in rules for who in rule.who if who.key is not None}
        self._keys = (_NO_KEY, *sorted(pinned))

    def __call__(self, node: str, kind: Kind, name: str) -> bool:
        """Whether `node` has any right on the topic or service `name`; of itself, any at all."""
        held = [grant for grant in self._grants if covers(grant.subject, node, wildcard=True)]
        if kind is Kind.NODE:
            return bool(held) or any(map(self._has_rules, self._subjects(node)))
        return Reach.of(held).covers_any(RIGHTS[kind], name) or any(
            self._allows(subject, right, name)
            for subject in self._subjects(node)
            for right in RIGHTS[kind]
        )

    def _subjects(self, node: str) -> list[Subject]:
        return [Subject(node, key) for key in self._keys]

    def _has_rules(self, subject: Subject) -> bool:
        return self._decider is not None and bool(self._decider.rules_of(subject))

    def _allows(self, subject: Subject, right: Right, name: str) -> bool:
        if self._decider is None:
            return False
        return self._decider.decide(subject, right, name).effect is not Effect.DENY


def read_grants(directory: Path) -> list[Grant]:
    """The grants in the files `*.grant` of a directory, not verified.

    Raises:
        ConfigurationError: there are none, or a file is not a grant.
    """
    found = []
    for path in sorted(directory.glob(SUFFIX)):
        try:
            found.append(peek(read_token(path)))
        except GrantError as error:
            raise ConfigurationError(f"{path} is not a grant: {error}", error.hint) from None
    if not found:
        raise ConfigurationError(
            f"there are no grants in {directory}", f"it is a folder with files {SUFFIX}"
        )
    return found
