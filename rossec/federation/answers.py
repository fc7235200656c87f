"""The answers of `rossec.followSite`: what one site has sent so far, and where to go on. Pure.

An answer may come in parts; the parts are gathered, and taken over together. An empty one says that
nothing has changed. A version that runs backwards within one run of the master is an error: a
master does not forget.
"""

from typing import Final, NamedTuple

from rossec.errors import AnswerMalformed
from rossec.master.state.imported_facts import FACTS_LIMIT
from rossec.participant.graph_view import Fact, facts_of

METHOD: Final = "rossec.followSite"
MAX_PARTS: Final = 256  # until an answer is complete, also of those that `whole` made void
MAX_GATHERED: Final = 2 * FACTS_LIMIT  # facts in all of them: those added, and those removed
_DIGEST: Final = 32
_NONE: Final[frozenset[Fact]] = frozenset()
_HALF: Final = 1 << 30  # versions count modulo 2**31, the integers of XML-RPC


class SiteChange(NamedTuple):
    """A complete answer.

    Args:
        added, removed: facts with the site's own names.
        whole: `added` is all there is.
        revocations, domains: digests of the lists that the site holds; empty: none.
    """

    added: frozenset[Fact]
    removed: frozenset[Fact]
    whole: bool
    revocations: bytes
    domains: bytes


class SiteCursor:
    """What to ask a site next.

    Attributes:
        instance: of the run of the master that answered last; empty: none has.
        version: of its graph then.
    """

    def __init__(self) -> None:
        self._begin_again()

    def _begin_again(self) -> None:
        self.instance = ""
        self.version = -1
        self._cursor = 0
        self._parts: list[SiteChange] = []
        self._taken = 0  # parts since the last complete answer
        self._gathered = 0  # facts in them
        self._lists = b"", b""  # the digests of the last answer

    def reconnected(self) -> None:
        """What parts the site sends from now on is counted anew, beside those that are held."""
        self._taken = len(self._parts)
        self._gathered = sum(len(each.added) + len(each.removed) for each in self._parts)

    @property
    def params(self) -> tuple[str, int]:
        """Instance and cursor, as the call has them."""
        return self.instance, self._cursor

    def take(self, answer: object) -> SiteChange | None:
        """Take an answer, or a part of it; returns the change when it is complete.

        Raises:
            AnswerMalformed: it is invalid, or the version runs backwards.
        """
        if answer == {} and self.instance:
            return self._complete([*self._parts, SiteChange(_NONE, _NONE, False, *self._lists)])
        match answer:
            case {
                "instance": str() as instance, "version": int() as version,
                "cursor": int() as cursor, "whole": bool() as whole, "more": bool() as more,
                "added": list() as added, "removed": list() as removed, **lists,
            }:  # fmt: skip
                revocations = _digest(lists.get("revocations", b""))
                domains = _digest(lists.get("domains", b""))
            case _:
                raise AnswerMalformed("a site's answer that is malformed")
        part = SiteChange(facts_of(added), facts_of(removed), whole, revocations, domains)
        self._check(instance, version)
        self.instance, self.version, self._cursor = instance, version, cursor
        self._lists = revocations, domains
        if whole:
            self._parts.clear()
        self._parts.append(part)
        self._taken += 1
        self._gathered += len(part.added) + len(part.removed)
        if self._taken > MAX_PARTS or self._gathered > MAX_GATHERED:
            in_parts = self._taken > MAX_PARTS
            self._begin_again()
            raise AnswerMalformed(
                f"a site's answer in more than {MAX_PARTS} parts" if in_parts
                else f"a site's answer with more than {MAX_GATHERED} facts"
            )  # fmt: skip
        if more:
            return None
        return self._complete(self._parts)

    def _complete(self, parts: list[SiteChange]) -> SiteChange:
        self._parts, self._taken, self._gathered = [], 0, 0
        return _joined(parts)

    def _check(self, instance: str, version: int) -> None:
        if instance == self.instance and (version - self.version) % (2 * _HALF) >= _HALF:
            raise AnswerMalformed("a site's version runs backwards")


def _joined(parts: list[SiteChange]) -> SiteChange:
    added, removed = set[Fact](), set[Fact]()
    for part in parts:  # in place: each part alone costs, not all before it again
        added |= part.added
        added -= part.removed
        removed |= part.removed
        removed -= part.added
    last, whole = parts[-1], parts[0].whole
    return SiteChange(frozenset(added), frozenset(removed), whole, last.revocations, last.domains)


def _digest(value: object) -> bytes:
    value = b"" if value == "" else value
    if not isinstance(value, bytes) or len(value) not in (0, _DIGEST):
        raise AnswerMalformed("a site's answer that is malformed")
    return value
