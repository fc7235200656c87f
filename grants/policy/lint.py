"""Advice on a valid policy: what is allowed but unwise, by a table of checks.

Precision removed from one field is often still in related fields, on other topics, or with another
node of the same owner. So each check sees what a receiver gets from all rules together
(`lint_views`), and what a field shows is decided by its type (`lint_facts`). Each kind of advice
has a stable code (`lint_findings`). A check yields findings and changes nothing.
"""

from collections.abc import Callable, Iterator
from typing import Final

from grants.policy import (
    lint_conditions,
    lint_fields,
    lint_parameters,
    lint_related,
    lint_relatives,
    lint_rules,
)
from grants.policy.lint_findings import ADVICE, Finding
from grants.policy.lint_views import LayoutOf, Scene, sample_subject
from grants.policy.model import Policy

__all__ = ["ADVICE", "Finding", "lint", "sample_subject"]

CHECKS: Final[tuple[Callable[[Scene], Iterator[Finding]], ...]] = (
    lint_rules.reasons_and_times,
    lint_rules.width,
    lint_rules.stale,
    lint_rules.shadowed,
    lint_rules.unused,
    lint_conditions.oracles,
    lint_fields.beside_position,
    lint_fields.other_coordinates,
    lint_fields.other_names,
    lint_parameters.parameters,
    lint_parameters.rates,
    lint_relatives.relatives,
    lint_relatives.saved_poses,
    lint_relatives.unknown,
    lint_relatives.second_receivers,
    lint_relatives.versions,
    lint_relatives.pseudonyms,
    lint_relatives.wheels,
    lint_related.related,
    lint_related.presence,
    lint_related.services,
    lint_related.graph,
)


def lint(policy: Policy, layout_of: LayoutOf) -> list[Finding]:
    """All advice on `policy`, in the order of the file, each piece once."""
    scene = Scene(policy, layout_of)
    return sorted({finding for check in CHECKS for finding in check(scene)})
