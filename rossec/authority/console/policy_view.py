"""The policy file, and what putting it in force would change, for a person to approve."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from ca.encoding import Value
from ca.errors import HintedError
from grants.errors import PolicyRefused
from grants.policy.changes import Change, Kind
from grants.policy.source import MAX_SIZE
from rossec import files
from rossec.authority.console.records import to_value
from rossec.authority.console.views import PolicyRight, PolicyView
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile
from rossec.errors import ConfigurationError

PURPOSE: Final = "a look at the policy"
MAX_REFUSED: Final = 64
_NOT_GIVEN: Final = frozenset({Kind.KEPT, Kind.GONE})


class PolicyLook:
    """The operation that compares the policy with the grants in force."""

    def __init__(self, work: AuthorityWork) -> None:
        self._work = work

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"policy": self.policy}

    def policy(self) -> Value:
        """The difference, or the mistakes for which there is none."""
        path = self._work.policy_path()
        empty = PolicyView(str(path), b"", (), (), 0, ())
        if not path.exists():
            return to_value(empty)
        read = b""
        try:
            read = files.read(path, MAX_SIZE, ConfigurationError(f"there is no policy in {path}"))
            file = PolicyFile.read(path, own=True)
            read = file.text.encode()
            with self._work.service(PURPOSE) as service:
                plan = service.plan_policy(file)
        except HintedError as error:
            digest = hashlib.sha256(read).digest() if read else b""
            return to_value(empty._replace(digest=digest, mistakes=_mistakes(error)))
        changes = [change for node in plan.nodes for change in node.changes]
        kept = [change for change in changes if change.kind is Kind.KEPT]
        return to_value(
            empty._replace(
                digest=hashlib.sha256(read).digest(),
                gives=tuple(_right(each) for each in changes if each.kind not in _NOT_GIVEN),
                takes=tuple(_right(each) for each in changes if each.kind is Kind.GONE),
                keeps=len(kept),
                refused=plan.refused[:MAX_REFUSED],
            )
        )


def _right(change: Change) -> PolicyRight:
    """A right; the last line of one that is given is its validity (`grants.policy.changes`)."""
    lines: Sequence[str] = change.restrictions
    until = ""
    if change.kind is not Kind.GONE:
        *lines, until = change.restrictions
    words, span = "; ".join(lines), until.removeprefix("valid ")
    return PolicyRight(change.subject.name, int(change.right), change.pattern, words, span)


def _mistakes(error: HintedError) -> tuple[str, ...]:
    found = error.mistakes if isinstance(error, PolicyRefused) else ()
    return tuple(map(str, found)) or (str(error),)
