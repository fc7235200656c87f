"""Every way a grant, a condition, a filter or a policy can be refused.

The subclasses name the cause: the issuer (malformed), the peer (forged, not its own, missing),
time (expired, revoked), or the author of the rule (condition, filter).
"""

from ca.errors import HintedError


class GrantError(HintedError):
    """Base class of the errors of `grants`."""


class GrantMalformed(GrantError):
    """Outside the closed schema: unknown, missing or impossible content."""


class GrantForged(GrantError):
    """Not signed by the key it needs, changed after it was signed, or another kind of statement."""


class GrantExpired(GrantError):
    """The grant is no longer valid."""


class GrantNotYetValid(GrantError):
    """The grant is not valid yet."""


class GrantNotHeld(GrantError):
    """A valid grant that is bound to another key."""


class GrantRevoked(GrantError):
    """The revocation check refused the grant; the cause says whether revoked or unknown."""


class GrantMissing(GrantError):
    """No presented grant covers the request.

    `near_misses` lists what the presented grants cover instead, one line each; `remedy` what to do.
    """

    def __init__(self, message: str, near_misses: tuple[str, ...] = (), remedy: str = "") -> None:
        hints = (*near_misses, remedy) if remedy else near_misses
        super().__init__(message, "; ".join(hints) or "ask the authority for a grant")
        self.near_misses = near_misses


class GrantForOther(GrantError):
    """A valid narrowing, delegation or ticket for another grant, key, authority or domain."""


class GrantTooWide(GrantError):
    """More narrowings than the link before allows, or a ticket for longer than it may last."""


class YamlRefused(GrantError):
    """Text that is not YAML, or outside the subset; `line` and `column` count from 1."""

    def __init__(self, message: str, hint: str = "", line: int = 1, column: int = 1) -> None:
        super().__init__(message, hint)
        self.line = line
        self.column = column


class PolicyRefused(GrantError):
    """A policy with mistakes; `mistakes` holds all of them, the message the first."""

    def __init__(self, message: str, hint: str = "", mistakes: tuple[object, ...] = ()) -> None:
        super().__init__(message, hint)
        self.mistakes = mistakes


class DefinitionRefused(GrantError):
    """A message definition that is malformed, incomplete or too large."""


class DefinitionIncomplete(DefinitionRefused):
    """A message definition without that of a type it uses."""


class FilterRefused(GrantError):
    """A filter rule that does not fit its message type."""


class ConditionRefused(GrantError):
    """A condition outside the language, or one that does not fit its message type."""


class MessageRefused(GrantError):
    """A message that does not have the layout of its type; it is dropped."""


class RenewalNotInTime(GrantError):
    """A delegation or ticket that is not valid now, or newer than the verifier's revocation list."""
