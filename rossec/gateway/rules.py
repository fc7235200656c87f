"""What a gateway shall serve: topics of another domain, and how they come over the line. Pure.

A rule is a pattern of the origin's own names. Of several that cover a topic the first one counts.
What gateways of the origin serve is covered by patterns below `/gateway` alone: two domains whose
gateways serve each other's `/**` would hand the same topics to and fro, under ever longer names.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from ca.domains.aliases import alias_of, check_label, is_alias, split_alias
from ca.domains.served import is_in_gateway
from ca.errors import HintedError
from ca.patterns import check_pattern, covers
from rossec.errors import ConfigurationError
from rossec.participant.wishes import Wishes

MAX_RULES: Final = 256


@dataclass(frozen=True)
class TopicRule:
    """Topics of the domain `label` that `pattern` covers, with the wishes for them."""

    label: str
    pattern: str
    wishes: Wishes = Wishes()  # noqa: RUF009 - has no state


def rule(label: str, pattern: str, wishes: Wishes) -> TopicRule:
    """A rule of what a person wrote.

    Raises:
        ConfigurationError: no label, or no pattern of the origin's names.
    """
    try:
        check_label(label)
    except HintedError as error:
        raise ConfigurationError(str(error), "rossec domain list shows the labels") from error
    own = _origins(label, pattern)
    if own != pattern:
        raise ConfigurationError(
            f"{pattern[:255]!a} is a name here, not at its origin", f"--from {label} {own}"
        )
    try:
        check_pattern(pattern)
        alias_of(label, "/x")
    except HintedError as error:
        raise ConfigurationError(str(error), error.hint) from error
    if is_alias(pattern):
        raise ConfigurationError(
            f"{pattern} is what {label} calls other domains' topics: they travel one hop",
            "take the topic from its own domain: --from THAT-DOMAIN PATTERN",
        )
    return TopicRule(label, pattern, wishes)


def _origins(label: str, pattern: str) -> str:
    """The pattern as the origin writes it, of one that was written with a label."""
    for prefix in (f"{label}:", f"/remote/{label}"):
        if pattern.startswith(f"{prefix}/"):
            return pattern.removeprefix(prefix)
    return pattern


def covering(rules: Sequence[TopicRule], alias: str) -> TopicRule | None:
    """The first rule that covers a topic, by its alias; None: there is none."""
    found = split_alias(alias)
    if found is None:
        return None
    label, name = found
    of_label = (each for each in rules if each.label == label)
    if is_in_gateway(name):
        of_label = (each for each in of_label if is_in_gateway(each.pattern))
    return next((each for each in of_label if covers(each.pattern, name)), None)
