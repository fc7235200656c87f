"""What most pages begin with: nodes, grants and the graph, asked of the service, as a matrix.

Without a master there is no graph and there are no denials: pages show the rest and say so.
"""

import logging
from contextlib import suppress
from typing import Final, NamedTuple

from ca.errors import HintedError, PatternRefused
from ca.patterns import check_pattern
from rossec.authority.console.views import DenialView, FactView, GrantQuestion, NodeView
from rossec.console import made_up
from rossec.console.context import ConsoleContext
from rossec.console.endings import Heard
from rossec.console.matrix import HeldGrant, Matrix, TopicRow, build, held_grants
from rossec.console.names import NONE, Names
from rossec.console.pictures import looks
from rossec.errors import HttpRefused, KeyServiceFailed
from rossec.ros.text import printable

MAX_REFUSED: Final = 12
AGAIN: Final = 5  # seconds after which a page looks again at what is ending
_log = logging.getLogger("rossec.console")


class Overview(NamedTuple):
    """The home at one moment; `without_master`: it does not answer, so there is no graph.

    `heard`: what was ended and every node knows.
    """

    nodes: tuple[NodeView, ...]
    held: tuple[HeldGrant, ...]
    facts: tuple[FactView, ...]
    matrix: Matrix
    without_master: bool
    heard: Heard
    now: int

    @property
    def ending(self) -> frozenset[str]:
        """Ids of grants and keys of nodes, in hex, that were ended and may still be used."""
        grants = [each for each in self.held if each.is_ending]
        keys = {each.grant.holder for each in grants}
        return frozenset(
            {each.view.id.hex() for each in grants}
            | {each.key.hex() for each in self.nodes if self._may_still_be_used(each, keys)}
        )

    def _may_still_be_used(self, node: NodeView, keys: set[bytes]) -> bool:
        if not node.revoked_at or node.not_after <= self.now:
            return False
        return node.key in keys or not self.heard.has(node.revoked_at, keeps=False)

    def named(self, name: str) -> list[NodeView]:
        """The identities of a name: its newest first."""
        found = [node for node in self.nodes if node.name == name]
        return sorted(found, key=lambda node: -node.not_before)


async def load(context: ConsoleContext, names: Names = NONE) -> Overview:
    """Ask for it; `names` has the types of topics that the graph and the grants do not tell.

    Raises:
        HintedError: the service refuses, or is not there.
        GrantMalformed: the record has a grant that cannot be read.
    """
    now = context.clock()
    nodes, grants = await context.service.nodes(), await context.service.grants()
    facts: tuple[FactView, ...] = ()
    without_master = False
    try:
        facts = await context.service.graph()
    except HintedError as error:
        _log.info("there is no graph: %s", printable(error))
        without_master = True

    def view() -> Overview:
        heard = context.endings.heard
        held = held_grants(nodes, grants, now, heard)
        matrix = build(held, facts, now, names.type_of)
        return Overview(nodes, held, facts, matrix, without_master, heard, now)

    found = view()
    if not found.ending or without_master:
        return found
    with suppress(HintedError):  # then it is not known, and said to be ending
        context.endings.note(await context.service.standing(0, 0), now)
    return view()


def again(home: Overview) -> int:
    """In how many seconds the page looks again; 0: when something has changed."""
    return AGAIN if home.ending and not home.without_master else 0


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
    applied = [each for cell in row.seen_by() for each in cell.restrictions]
    recorded = real if real is not None else made_up.recorded(row.topic, row.type, applied)
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
