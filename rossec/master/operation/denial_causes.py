"""Refusals for the log and the audit: one line for each cause, in the words of `rossec explain`.

A cause is a right that a node lacks on a name; names of one run of an anonymous node are the same
cause as those of the next. It is logged once an hour, with the number of refusals left out. What
every ROS program asks for by itself and works without is one cause for each node. Refusals for
other reasons, such as an address of another node, are all logged. Pure.
"""

from collections import OrderedDict
from dataclasses import dataclass
from typing import Final

from ca.domains.aliases import shown
from grants.basics import is_dispensable, own_form
from grants.missing_rights import needed_rule, rule_form
from grants.model import Right
from rossec.master.api.methods import CallDenied

LOGGED_FOR: Final = 3600  # seconds
MAX_CAUSES: Final = 4096
BASICS: Final = "do all that every ROS program asks for and works without, as "
_NO_GRANT: Final = "no grant "

_Cause = tuple[str, Right | None, str]


@dataclass
class _Logged:
    at: int
    left_out: int = 0


class DenialCauses:
    """The causes that were logged last."""

    def __init__(self) -> None:
        self._logged: OrderedDict[_Cause, _Logged] = OrderedDict()

    def text(self, now: int, denied: CallDenied) -> str | None:
        """What to log after the node and `may not`; None if the cause was logged before.

        Of what every program works without it begins with `BASICS`: it is no warning.
        """
        if denied.missing is None:
            return f"{denied.method}: {denied.status}"
        right, name = denied.missing
        own = own_form(denied.certified, name, wildcard=denied.wildcard)
        reason = denied.status.partition(f" on {shown(name)}: ")[2]
        if is_dispensable(right, own) and reason.startswith(_NO_GRANT):
            return self._once(now, (denied.node, None, ""), _basics(right, own))
        ruled = rule_form(denied.certified, name, wildcard=denied.wildcard)
        words = _words(denied.node, right, shown(ruled), reason)
        cause = (denied.node, right, own + reason[:80])
        return self._once(now, cause, f"{right.label} {shown(ruled)} ({denied.method}): {words}")

    def _once(self, now: int, cause: _Cause, text: str) -> str | None:
        before = self._logged.get(cause)
        if before is not None and 0 <= now - before.at < LOGGED_FOR:
            before.left_out += 1
            return None
        self._logged[cause] = _Logged(now)
        self._logged.move_to_end(cause)
        if len(self._logged) > MAX_CAUSES:
            self._logged.popitem(last=False)
        left_out = before.left_out if before is not None else 0
        return f"{text} ({left_out} more like this since it was logged last)" if left_out else text


def _words(node: str, right: Right, name: str, reason: str) -> str:
    if reason.startswith(_NO_GRANT):
        return f"{needed_rule(node, [(right, name)])} would change it"
    return reason


def _basics(right: Right, own: str) -> str:
    return f"{BASICS}{right.label} {own} and so on: basics: true in a policy would change it"
