"""The words for rights that no rule gives: the same on every screen, in the audit, in `explain`.

A node is told nothing but what it asked for itself; which rules nearly match only the authority
knows (`rossec explain`). A refusal for another reason, such as an expired grant, is not of these.
"""

import re
from collections.abc import Iterable
from typing import Final, NamedTuple

from grants.basics import own_form
from grants.model import ALL_RIGHTS, Right

_RIGHTS: Final = {right.label: right for right in ALL_RIGHTS}
_STATUS: Final = re.compile(
    r"(?:rossec: )?(\S+?)(?: \(certified as (\S+)\))? needs the right ([a-z-]+) on (\S+):"
    r" no grant .*",
    re.DOTALL,
)
_IN_SHELL: Final = re.compile(r"[A-Za-z0-9_/:]+", re.ASCII)
_PLAIN: Final = re.compile(r"[^{}\[\],:#&*!|>'\"%@`\s][^{}\[\],:#\s]*", re.ASCII)


class MissingRight(NamedTuple):
    """A right that `node`, a certified name, lacks; `asker` is its name where it is anonymous."""

    node: str
    asker: str
    right: Right
    name: str

    @property
    def own(self) -> str:
        """The name in the form of `own_form`: `{node}/...` below the asker's own name."""
        return own_form(self.node, self.name, wildcard=self.asker != self.node)

    @property
    def in_rule(self) -> str:
        """The name as a rule would write it."""
        return rule_form(self.node, self.name, wildcard=self.asker != self.node)

    def __str__(self) -> str:
        return f"{self.node} may not {self.right.label} {self.name}"


def rule_form(node: str, name: str, *, wildcard: bool) -> str:
    """`name` as a rule would write it: with `{node}` where it is of one run of `node` only."""
    return name if name.startswith(f"{node}/") else own_form(node, name, wildcard=wildcard)


def missing_right(status: str) -> MissingRight | None:
    """What the status of a refused call says is missing; None if it was refused otherwise."""
    match = _STATUS.fullmatch(status)
    if match is None or match[3] not in _RIGHTS:
        return None
    return MissingRight(match[2] or match[1], match[1], _RIGHTS[match[3]], match[4])


def needed_rule(node: str, rights: Iterable[tuple[Right, str]]) -> str:
    """What would give `node` these rights: `an allow rule for /x with subscribe: [/y]`."""
    names: dict[str, list[str]] = {}
    for right, name in dict.fromkeys(rights):
        names.setdefault(right.label, []).append(_in_yaml(name))
    given = ", ".join(f"{label}: [{', '.join(found)}]" for label, found in names.items())
    return f"an allow rule for {node} with {given}"


def grant_command(node: str, rights: Iterable[tuple[Right, str]]) -> str:
    """The command that gives `node` these rights, for who holds the authority."""
    options = dict.fromkeys(_option(right, name) for right, name in rights)
    return f"rossec grant sign {node} {' '.join(options)}"


def remedy(node: str, right: Right, name: str) -> str:
    """The commands that give `node` a right it lacks: at its authority, or as a request.

    Short: an answer to many calls in one says it for each of them.

    Args:
        name: as `MissingRight.in_rule` has it.
    """
    sign = grant_command(node, [(right, name)])
    return sign if right is Right.ADMIN else f"{sign}, or ask: `rossec grant request`"


def in_shell(name: str) -> str:
    """A name or pattern as it is typed in a shell."""
    return name if _IN_SHELL.fullmatch(name) else f"'{name}'"


def _option(right: Right, name: str) -> str:
    return "--graph" if right is Right.GRAPH else f"--{right.label} {in_shell(name)}"


def refusal(node: str, missing: Iterable[tuple[Right, str]]) -> str:
    """One line for all that `node` lacks, at least one right: with a policy, and without one."""
    [first, *more] = listed = list(dict.fromkeys(missing))
    what = "do all that it asks for" if more else f"{first[0].label} {first[1]}"
    command = grant_command(node, listed)
    return f"{node} may not {what}: {needed_rule(node, listed)} would change it, or {command}"


def _in_yaml(name: str) -> str:
    """A name as it stands in a list of YAML."""
    return name if _PLAIN.fullmatch(name) else f"'{name}'"
