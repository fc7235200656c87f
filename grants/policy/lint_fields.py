"""Advice on fields of one message: what is left open beside a filtered field gives it away.

The attackers' figures are in docs/spec/policy.md, "Lint": a rounded position with an exact twist
is the path to 0.05 m; a rounded joint with an exact velocity is the joint.
"""

from collections.abc import Iterator
from typing import Final

from grants.policy.lint_facts import Aspect
from grants.policy.lint_findings import Finding
from grants.policy.lint_suggest import closing
from grants.policy.lint_views import Scene, View

_PLACES: Final = (Aspect.POSITION, Aspect.JOINT)
_BESIDE: Final[dict[Aspect, tuple[str, str]]] = {
    Aspect.MOVEMENT: ("movement-open", "the exact path follows from it by integration"),
    Aspect.JOINT_RATE: ("movement-open", "the exact path follows from it by integration"),
    Aspect.COVARIANCE: ("covariance-open", "it reveals the precision of the hidden value"),
    Aspect.HEADING: ("heading-open", "turns reveal the direction of movement"),
    Aspect.TIME: ("time-open", "the exact time of a cell change reveals the exact position"),
    Aspect.COUNT: ("time-open", "counting messages reveals the exact time"),
}
_CELLS: Final = (Aspect.TIME, Aspect.COUNT)  # without a value there are no cells to change


def beside_position(scene: Scene) -> Iterator[Finding]:
    """What follows a filtered position in the same message, and is open."""
    for view in _views(scene):
        treated = view.treated(*_PLACES)
        coarse = view.coarse(*_PLACES)
        for aspect, (code, why) in _BESIDE.items() if treated else ():
            open_fields = view.exact(aspect)
            if open_fields and (coarse or aspect not in _CELLS):
                yield _open(view, code, treated[0], open_fields, why)


def other_coordinates(scene: Scene) -> Iterator[Finding]:
    """One coordinate filtered, another not; a height indoors does not change."""
    for view in _views(scene):
        treated = view.treated(Aspect.POSITION)
        rest = [path for path in view.exact(Aspect.POSITION) if not path.endswith(".z")]
        if treated and rest:
            yield _open(view, "position-open", treated[0], rest, "it shows the place as well")


def other_names(scene: Scene) -> Iterator[Finding]:
    """One name of a thing hidden, another not."""
    for view in _views(scene):
        treated, rest = view.treated(Aspect.NAME), view.exact(Aspect.NAME)
        if treated and rest:
            why = "a name that occurs once links all that is said of it"
            yield _open(view, "name-open", treated[0], rest, why)


def _views(scene: Scene) -> Iterator[View]:
    return (view for views in scene.views.values() for view in views if view.filters)


def _open(view: View, code: str, hidden: str, open_fields: list[str], why: str) -> Finding:
    path, text, suggestions = closing(view, open_fields)
    rule = view.rule
    filtered = view.filter_on(hidden).path
    what = f"{filtered} of {view.topic} is filtered, {path} is not: {why}"
    return Finding(rule.line, code, f"rule {rule.id}: {what}", f"add {text}", suggestions)
