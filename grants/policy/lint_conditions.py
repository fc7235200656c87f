"""Advice on conditions: a condition on a field that the same receiver may not see is an oracle.

That a message comes says that the condition held: of a position that is cleared, `x < 5` told the
crossing to 0.13 s (docs/spec/policy.md, "Lint"), and `frame_id == "map"` tells a cleared name.
"""

from collections.abc import Iterator

from grants.conditions.fields import fields_read
from grants.policy.lint_findings import Finding, Suggestion
from grants.policy.lint_views import Precision, Scene, View
from grants.policy.model import PolicyRule


def oracles(scene: Scene) -> Iterator[Finding]:
    """Conditions on fields that filters hide from the same receiver."""
    for views in scene.views.values():
        for view in views:
            if view.filters:
                yield from _oracles_of(view)


def _oracles_of(view: View) -> Iterator[Finding]:
    for rule, text in _conditions(view):
        for path in fields_read(text):
            left = view.left(path)
            if left is Precision.EXACT:
                continue
            how = "coarsely" if left is Precision.COARSE else "not at all"
            message = (
                f"rule {rule.id}: {view.receiver.label} sees {path} of {view.topic} {how},"
                f" but a condition on it tells its value"
            )
            hint = f"remove the condition on {path}, or leave the field as it is"
            change = (Suggestion(rule.id, without=text),)
            yield Finding(rule.line, "condition-tells", message, hint, change)


def _conditions(view: View) -> Iterator[tuple[PolicyRule, str]]:
    for rule, clause in zip(view.verdict.rules, view.verdict.clauses, strict=True):
        for text in clause.restriction.conditions if clause.restriction is not None else ():
            yield rule, text
