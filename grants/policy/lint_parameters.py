"""Advice on parameters: what is missing for a step to hold, and values that do nothing.

Floors are what sensors err anyway, or what the attackers of docs/spec/policy.md, "Lint", needed.
An array has no hysteresis (docs/spec/grant.md 6.1), so it is not advised there: an array is
cleared.
"""

from collections.abc import Callable, Iterator
from typing import Final

from grants.model import FilterRule, Scalar
from grants.policy.lint_facts import Aspect
from grants.policy.lint_findings import Finding
from grants.policy.lint_suggest import (
    ACROSS,
    BLOCK,
    COARSE_DEGREES,
    COARSE_JOINT,
    COARSE_STEP,
    COARSE_TIME,
    LEVELS,
    ROOM_REACH,
    SHARE,
    limiting,
    replacing,
)
from grants.policy.lint_views import Precision, Scene, View, too_fine, too_small
from grants.policy.privacy import filters_of
from grants.vocabulary.levels import Treatment
from grants.vocabulary.rooms import NARROWEST, SMALLEST, narrowest, smallest

_FASTEST: Final = 2.0  # a second: at a walk one message every half metre
_SMALLEST_SHARE: Final = 10  # a hysteresis below this part of a step is noise
_CELLS: Final = ("round", "rooms")
_MOST_LEVELS: Final = 16
_REGION: Final = ("x", "y", "width", "height")
_DENSE: Final = (Aspect.POSITION, Aspect.SURROUNDINGS)


def parameters(scene: Scene) -> Iterator[Finding]:
    """Each filter of each view, by the table of its operator."""
    for views in scene.views.values():
        for view in views:
            for rule, paths in _treated(view).items():
                yield from _OPERATORS.get(rule.operator, _nothing)(view, rule, paths)


def rates(scene: Scene) -> Iterator[Finding]:
    """A coarse value, or an empty message, at the full rate or a high one."""
    for views in scene.views.values():
        for view in views:
            rounded = any(
                view.filter_on(path).operator in _CELLS for path in view.coarse(Aspect.POSITION)
            )
            squares = bool(view.coarse(Aspect.IMAGE))
            if (rounded or squares or view.is_empty) and not view.has_slot:
                yield from _rate(view, "coarse" if rounded or squares else "empty")


def _rate(view: View, what: str) -> Iterator[Finding]:
    hint, suggestions = limiting(view)
    begin = f"rule {view.rule.id}: {view.topic} is {what}"
    if view.verdict.rate is None:
        message = f"{begin}, but sent at the full rate"
        yield Finding(view.rule.line, "no-rate", message, hint, suggestions)
    elif view.verdict.rate > _FASTEST:
        message = f"{begin}, but {view.verdict.rate:g} messages a second hide no movement"
        yield Finding(view.rule.line, "rate-does-nothing", message, hint, suggestions)


def _treated(view: View) -> dict[FilterRule, list[str]]:
    """The leaves that show something, by the filter that treats them; not what another hides."""
    found: dict[FilterRule, list[str]] = {}
    for path in view.aspects:
        if view.left(path) is not Precision.HIDDEN:
            for rule in filters_of(view.filters, path):
                found.setdefault(rule, []).append(path)
    return found


def _nothing(_view: View, _rule: FilterRule, _paths: list[str]) -> Iterator[Finding]:
    yield from ()


def _round(view: View, rule: FilterRule, paths: list[str]) -> Iterator[Finding]:
    fine = [
        path
        for path in paths
        if too_fine(rule, view.aspects[path], path) and view.left(path) is Precision.EXACT
    ]
    places = [path for path in paths if view.aspects[path] is Aspect.POSITION]
    if fine:
        what = f"{rule.path} of {view.topic} is rounded to {_step(rule):g}, less than sensors err"
        yield _finding(view, rule, "step-does-nothing", what, _coarser(rule, fine[0], view))
    elif _is_dense_array(view, paths):
        what = f"values of the array {rule.path} of {view.topic} together give the exact ones"
        yield _finding(view, rule, "rounded-array", what, FilterRule(rule.path, "clear"))
    elif places:
        yield from _hysteresis(view, rule)


def _hysteresis(view: View, rule: FilterRule) -> Iterator[Finding]:
    share = dict(rule.parameters).get("hysteresis")
    better = _with_hysteresis(rule, _step(rule))
    if share is None and not _has_hysteresis(view, rule):
        yield _finding(
            view, rule, "no-hysteresis", f"{rule.path} is rounded without hysteresis", better
        )
    elif share is not None and float(share) * _SMALLEST_SHARE < _step(rule):
        what = f"a hysteresis of {share} on {rule.path} of {view.topic} is within the noise"
        yield _finding(view, rule, "hysteresis-does-nothing", what, better)


def _has_hysteresis(view: View, rule: FilterRule) -> bool:
    """Whether another filter of the same field has it."""
    others = (each for each in view.filters if each.path == rule.path)
    return any("hysteresis" in dict(each.parameters) for each in others)


def _coarser(rule: FilterRule, path: str, view: View) -> FilterRule:
    match view.aspects[path]:
        case Aspect.POSITION:
            degrees = path.endswith(("latitude", "longitude"))
            return _with_hysteresis(rule, COARSE_DEGREES if degrees else COARSE_STEP)
        case Aspect.JOINT:
            return FilterRule(rule.path, "round", (("step", COARSE_JOINT),))
        case Aspect.TIME:
            return FilterRule(rule.path, "round", (("step", COARSE_TIME),))
        case _:
            return FilterRule(rule.path, "clear")


def _with_hysteresis(rule: FilterRule, step: float) -> FilterRule:
    return FilterRule(rule.path, "round", (("hysteresis", step / SHARE), ("step", step)))


def _is_dense_array(view: View, paths: list[str]) -> bool:
    dense = [path for path in paths if view.aspects[path] in _DENSE]
    inside = any("[*]" in path for path in dense)
    return inside or any(view.aspects[path] is Aspect.SURROUNDINGS for path in dense)


def _step(rule: FilterRule) -> float:
    return float(dict(rule.parameters)["step"])


def _clamp(view: View, rule: FilterRule, paths: list[str]) -> Iterator[Finding]:
    places = [path for path in paths if view.aspects[path] is Aspect.POSITION]
    if places and all(view.left(path) is Precision.EXACT for path in places):
        what = f"{rule.path} of {view.topic} is clamped, and exact between the limits"
        yield _finding(view, rule, "clamp-keeps-values", what, _with_hysteresis(rule, COARSE_STEP))


def _rooms(view: View, rule: FilterRule, _paths: list[str]) -> Iterator[Finding]:
    parameters = dict(rule.parameters)
    plan = Treatment(rule.operator, rule.parameters)
    if smallest(plan) < SMALLEST or narrowest(plan) < NARROWEST:
        what = f"the rooms for {rule.path} of {view.topic} are smaller than rooms: a grid"
        better = _with_hysteresis(FilterRule(rule.path, "round"), COARSE_STEP)
        yield _finding(view, rule, "rooms-too-small", what, better)
    elif "hysteresis" not in parameters:
        what = f"{rule.path} is snapped to rooms without hysteresis: a door tells the position"
        better = _with(rule, hysteresis=ROOM_REACH)
        yield _finding(view, rule, "no-hysteresis", what, better)


def _pixelate(view: View, rule: FilterRule, _paths: list[str]) -> Iterator[Finding]:
    parameters = dict(rule.parameters)
    levels = parameters.get("levels")
    squares = _with(rule, across=ACROSS, block=max(_block(rule), BLOCK), levels=LEVELS)
    whole = tuple(item for item in squares.parameters if item[0] not in _REGION)
    if "width" in parameters and not _has_whole(view, rule):
        what = f"only a region of {view.topic} is in squares: beside it everything is as it is"
        better = FilterRule(rule.path, rule.operator, whole)
        yield _finding(view, rule, "region-open", what, better)
    elif too_small(rule):
        size = f"of {_block(rule)} pixels" if "block" in parameters else "as small as these"
        what = f"squares {size} of {view.topic} hide nobody"
        yield _finding(view, rule, "pixels-too-small", what, squares)
    elif "across" not in parameters:
        size = f"of {_block(rule)} pixels"
        what = f"squares {size} show a face where pictures of {view.topic} are large"
        yield _finding(view, rule, "pixels-fixed", what, squares)
    elif levels is None or int(levels) > _MOST_LEVELS:
        what = f"squares of {view.topic} in full colours show a face in ten moving pictures"
        yield _finding(view, rule, "no-grey-levels", what, _with(rule, levels=LEVELS))


def _block(rule: FilterRule) -> int:
    return int(dict(rule.parameters).get("block", 0))


def _has_whole(view: View, rule: FilterRule) -> bool:
    """Whether another filter treats all of the picture."""
    others = (each for each in filters_of(view.filters, rule.path) if each != rule)
    return any("width" not in dict(each.parameters) for each in others)


def _with(rule: FilterRule, **changed: float) -> FilterRule:
    parameters: dict[str, Scalar] = {**dict(rule.parameters), **changed}
    return FilterRule(rule.path, rule.operator, tuple(sorted(parameters.items())))


def _finding(view: View, old: FilterRule, code: str, what: str, better: FilterRule) -> Finding:
    text, suggestions = replacing(view, old, better)
    rule, _ = view.place(old)
    return Finding(rule.line, code, f"rule {rule.id}: {what}", f"write {text}", suggestions)


_OPERATORS: Final[dict[str, Callable[[View, FilterRule, list[str]], Iterator[Finding]]]] = {
    "round": _round,
    "clamp": _clamp,
    "pixelate": _pixelate,
    "rooms": _rooms,
}
