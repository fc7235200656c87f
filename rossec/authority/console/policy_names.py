"""What the policy calls things: titles for people, and the types of topics. It decides nothing.

Asked for every page, so the policy is read only when its file has changed. Without a policy, or
while it has mistakes, nothing has a title: pages show the names of ROS, as beside every title.
"""

from collections.abc import Callable, Mapping
from typing import Final

from ca.encoding import Value
from ca.errors import HintedError
from rossec.authority.console.reading import bounded
from rossec.authority.console.views import PolicyName
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.policyfile import PolicyFile

_NOTHING: Final = (0, 0, 0)


class PolicyNames:
    """The operation that tells titles and types."""

    def __init__(self, work: AuthorityWork) -> None:
        self._work = work
        self._read = _NOTHING
        self._names: tuple[PolicyName, ...] = ()

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"policy-names": self.names}

    def names(self) -> Value:
        """Every name or pattern that has a title or a type in the policy."""
        found = self._state()
        if found != self._read:
            self._names = self._load() if found != _NOTHING else ()
            self._read = found
        return bounded("names of the policy", self._names)

    def _state(self) -> tuple[int, int, int]:
        try:
            status = self._work.policy_path().stat()
        except OSError:
            return _NOTHING
        return status.st_mtime_ns, status.st_size, status.st_ino

    def _load(self) -> tuple[PolicyName, ...]:
        try:
            policy = PolicyFile.read(self._work.policy_path(), own=True).policy
        except HintedError:  # told on the page of the policy
            return ()
        return tuple(
            PolicyName(name, policy.titles.get(name, ""), policy.types.get(name, ""))
            for name in sorted(policy.titles.keys() | policy.types.keys())
        )
