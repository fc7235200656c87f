"""What people and programs are told of a site. Pure but for the clock that is passed."""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, Final

from rossec.federation.settings import SiteSettings
from rossec.federation.states import SiteState
from rossec.master.state.imports import Imports

NAMED: Final = 8 * 1024  # characters of all topics that are named; an answer is one line of a MiB


def site_status(
    settings: SiteSettings, state: SiteState, imports: Imports, clock: float
) -> dict[str, Any]:
    """The site, its state and its facts; `clock` is monotonic.

    `topics` are those with publishers or subscribers there, by their names here.
    """
    held = next((each for each in imports.sites if each.site.label == settings.label), None)
    topics = [] if held is None else held.topics()
    lost = state.lost_since
    return {
        "label": settings.label,
        "uri": settings.uri,
        "via": settings.via,
        "master": settings.master,
        "domain": settings.domain,
        "state": state.phase.value,
        "facts": 0 if held is None else held.facts,
        "lost_s": None if lost is None else round(clock - lost, 1),
        "parameters": list(settings.parameters),
        "topics": _bounded(topics),
        "topics_count": len(topics),
    }


def _bounded(topics: Sequence[str]) -> list[str]:
    ends = accumulate(len(topic) for topic in topics)
    return [topic for topic, end in zip(topics, ends, strict=True) if end <= NAMED]
