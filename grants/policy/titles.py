"""Names for people: `title:` says what a node or a topic is called at home. Pure.

    title: {/doctor: Dr. Meier, /robot/pose: where the robot is, lamps: a lamp of the house}

A title decides nothing: it is shown beside the name of ROS, never instead of it. So that it can
imitate neither a name nor another title, it is one short line without control, format or direction
characters, has no slash, and no two names have the same; that of a group is for its members.
"""

import unicodedata
from collections.abc import Iterable, Mapping
from typing import Final

from grants.policy import readers
from grants.policy.mistakes import Mistakes, suggest
from grants.policy.model import SubjectPattern
from grants.policy.source import Part, YamlScalar

MAX_TITLE: Final = 60  # characters
_MAX_MARKS: Final = 2  # combining ones in a row: more of them cover the lines above and below
_MARKS: Final = (["Mn"], ["Me"], ["Mc"])
_HARMFUL: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})


def flaw_of(title: str) -> str:
    """Why this is no title; empty if it is one."""
    kinds = [unicodedata.category(char) for char in title]
    spaces = {char for kind, char in zip(kinds, title, strict=True) if kind == "Zs"}
    flaws = (
        (not 1 <= len(title) <= MAX_TITLE, f"1 to {MAX_TITLE} characters"),
        (not _HARMFUL.isdisjoint(kinds), "no control, format or direction characters"),
        (not spaces <= {" "}, "no other spaces than the usual one"),
        (" ".join(title.split()) != title, "single spaces, and none at its ends"),
        (unicodedata.normalize("NFC", title) != title, "the composed form of Unicode (NFC)"),
        (kinds[:1] in _MARKS or _longest_run(kinds) > _MAX_MARKS, "few combining marks"),
        ("/" in title, "no slash: it would look like a name"),
    )
    return next((f"a title has {said}" for is_flawed, said in flaws if is_flawed), "")


def _longest_run(kinds: Iterable[str]) -> int:
    longest = run = 0
    for kind in kinds:
        run = run + 1 if kind in ("Mn", "Me") else 0
        longest = max(longest, run)
    return longest


def read_titles(
    part: Part | None, groups: Mapping[str, tuple[SubjectPattern, ...]], mistakes: Mistakes
) -> dict[str, str]:
    """Titles by the name of a node, a topic or a pattern; of a group by each name in it."""
    mapping = readers.mapping(part, "title", mistakes)
    found: dict[str, str] = {}
    of_groups: dict[str, str] = {}
    first: dict[str, YamlScalar] = {}
    for text, (key, value) in mapping.entries.items() if mapping is not None else ():
        title = _title(text, value, mistakes)
        names = _names(text, key, groups, mistakes)
        if title is None or not names:
            continue
        same = title.casefold()
        if same in first:
            readers.again(value, f"title: {title!r}", first[same], mistakes)
        first.setdefault(same, key)
        (of_groups if text in groups else found).update(dict.fromkeys(names, title))
    return {**of_groups, **found}


def _title(name: str, part: Part, mistakes: Mistakes) -> str | None:
    title = readers.text(part, f"the title of {name[:60]}", mistakes)
    flaw = "" if title is None else flaw_of(title)
    if flaw:
        mistakes.add(part, f"the title of {name[:60]}: {flaw}", "for example: Dr. Meier")
        return None
    return title


def _names(
    text: str, key: YamlScalar, groups: Mapping[str, tuple[SubjectPattern, ...]], mistakes: Mistakes
) -> tuple[str, ...]:
    """The names that a key stands for; none if it is a mistake."""
    if text.startswith("/") or ":" in text:
        name = readers.subject(key, "title", mistakes)
        return () if name is None else (name,)
    if text in groups:
        return tuple(each.node for each in groups[text] if each.node is not None)
    hint = suggest(text, groups) if groups else "a name begins with /: /doctor, /robot/pose"
    mistakes.add(key, f"title: {text[:60]!r} is neither a name nor a group", hint)
    return ()
