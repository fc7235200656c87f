"""What most pages begin with: nodes, grants and the graph, asked of the service, as a matrix.

Without a master there is no graph and there are no denials: pages show the rest and say so.
"""

import logging
from typing import Final, NamedTuple

from ca.errors import HintedError, PatternRefused
from ca.patterns import check_pattern
from rossec.authority.console.views import DenialView, FactView, GrantQuestion, NodeView
from rossec.console import made_up
from rossec.console.context import ConsoleContext
from rossec.console.matrix import HeldGrant, Matrix, TopicRow, build, held_grants
from rossec.console.pictures import looks
from rossec.errors import HttpRefused, KeyServiceFailed
from rossec.ros.text import printable

MAX_REFUSED: Final = 12
_log = logging.getLogger("rossec.console")


class Overview(NamedTuple):
    """The home at one moment; `without_master`: it does not answer, so there is no graph."""

    nodes: tuple[NodeView, ...]
    held: tuple[HeldGrant, ...]
    facts: tuple[FactView, ...]
    matrix: Matrix
    without_master: bool

    def named(self, name: str) -> list[NodeView]:
        """The identities of a name: its newest first."""
        found = [node for node in self.nodes if node.name == name]
        return sorted(found, key=lambda node: -node.not_before)


async def load(context: ConsoleContext) -> Overview:
    """Ask for it.

    Raises:
        HintedError: the service refuses, or is not there.
        GrantMalformed: the record has a grant that cannot be read.
    """
    now = context.clock()
    nodes, grants = await context.service.nodes(), await context.service.grants()
    held = held_grants(nodes, grants, now)
    facts: tuple[FactView, ...] = ()
    without_master = False
    try:
        facts = await context.service.graph()
    except HintedError as error:
        _log.info("there is no graph: %s", printable(error))
        without_master = True
    return Overview(nodes, held, facts, build(held, facts, now), without_master)


async def denials(context: ConsoleContext) -> tuple[DenialView, ...]:
    """The denials of the last day; none without a master."""
    try:
        return await context.service.denials()
    except HintedError:
        return ()


async def questions(context: ConsoleContext) -> tuple[tuple[GrantQuestion, ...], str]:
    """What nodes ask for, and why that is not known: the policy cannot be used; empty: it is."""
    try:
        return await context.service.questions(), ""
    except KeyServiceFailed:
        raise
    except HintedError as error:
        return (), str(error)


def refused_names(found: tuple[DenialView, ...]) -> dict[str, list[str]]:
    """The names that each node was refused, the latest first; of the nodes refused last."""
    names: dict[str, list[str]] = {}
    for denial in sorted(found, key=lambda each: -each.at):
        known = names.setdefault(denial.node, []) if len(names) < MAX_REFUSED else names.get(
            denial.node, []
        )  # fmt: skip
        if denial.name not in known:
            known.append(denial.name)
    return names


def comparison(context: ConsoleContext, row: TopicRow) -> looks.Comparison | None:
    """What the topic looks like to its receivers: by the preview, else made up; None: unknown."""
    if not row.type or row.is_pattern or not row.seen_by():
        return None
    real = context.preview.recorded(row.topic) if context.preview is not None else None
    recorded = real if real is not None else made_up.recorded(row.topic, row.type)
    found = None if recorded is None else looks.compare(recorded, row.cells)
    return found if found is not None and found.looks else None


def name_of(text: str) -> str:
    """The absolute name or pattern in a path, which came without its first slash.

    Raises:
        HttpRefused: it is not one.
    """
    try:
        return check_pattern(f"/{text}")
    except PatternRefused as error:
        raise HttpRefused("there is no such page", error.hint, status=404) from None


def position(text: str | None) -> int:
    """A number in an address: where a part of a long table begins.

    Raises:
        HttpRefused: it is no number.
    """
    if not text:
        return 0
    if not (text.isascii() and text.isdecimal() and len(text) <= 12):
        raise HttpRefused("there is no such page", "go back to the first", status=404)
    return int(text)
