"""Advice on other topics: what one receiver, or one owner, sees exactly beside something coarse.

Two nodes are of one owner if they have one key, are of one foreign domain, or one is below the
other's name: what one of them sees, the other knows.
"""

import re
from collections.abc import Iterable, Iterator
from itertools import permutations, product
from typing import Final

from ca.domains.aliases import is_alias
from grants.model import FilterRule, Right, Scalar
from grants.policy.lint_facts import Aspect
from grants.policy.lint_findings import Finding
from grants.policy.lint_suggest import coarsening, replacing
from grants.policy.lint_views import Receiver, Scene, View

_FRAME: Final = re.compile(r"""frame_id\s*==\s*(["'])([^"']*)\1""")
SAVED_POSE: Final = "/amcl/initial_pose_x"
_SHOWN_BY: Final[dict[Aspect, tuple[Aspect, ...]]] = {
    Aspect.POSITION: (
        Aspect.MOVEMENT,
        Aspect.SURROUNDINGS,
        Aspect.IMAGE,
        Aspect.JOINT,
        Aspect.JOINT_RATE,
        Aspect.HEADING,
        Aspect.STATE,
    ),
    Aspect.IMAGE: (),
    Aspect.NAME: (),
}
"""A treated aspect, and what else gives it away if it is seen exactly on another topic."""


def relatives(scene: Scene) -> Iterator[Finding]:
    """Topics that a receiver sees exactly beside one that shows the same coarsely."""
    for views in scene.views.values():
        for aspect, others in _SHOWN_BY.items():
            coarse = _first_treated(views, aspect)
            if coarse is not None:
                yield from _exact(coarse, views, aspect, others)


def saved_poses(scene: Scene) -> Iterator[Finding]:
    """The parameter in which localisation saves where the robot is, twice a second."""
    for receiver, views in scene.views.items():
        coarse = _first_treated(views, Aspect.POSITION)
        if coarse is None:
            continue
        verdict = scene.decider.decide(receiver.subject, Right.PARAM_GET, SAVED_POSE)
        if verdict:
            message = f"{_begin(coarse)}, but may read {SAVED_POSE}, where amcl saves the position"
            pattern = verdict.clauses[0].pattern
            hint = f"name the parameters it needs instead of {pattern}"
            yield Finding(verdict.rules[0].line, "exact-relative", message, hint)


def unknown(scene: Scene) -> Iterator[Finding]:
    """Topics of which nothing is known, beside a coarse position or picture."""
    for views in scene.views.values():
        coarse = _first_treated(views, Aspect.POSITION, Aspect.IMAGE)
        told = {_pattern(view) for view in views if view.is_below_pattern}
        for view in views if coarse is not None else ():
            if coarse is None or view.is_known or _is_own(view) or view.topic in told:
                continue
            message = f"{_begin(coarse)}, and {view.topic}, {_unknown(view)}"
            yield Finding(coarse.rule.line, "unknown-type", message, _judge(view))


def _first_treated(views: Iterable[View], *aspects: Aspect) -> View | None:
    return next((view for view in views if view.treated(*aspects)), None)


def _exact(
    coarse: View, views: Iterable[View], aspect: Aspect, others: tuple[Aspect, ...]
) -> Iterator[Finding]:
    below: dict[str, list[View]] = {}
    for view in views:
        if view is coarse or (aspect is Aspect.NAME and not _same_type(view, coarse)):
            continue
        if view.shows(aspect, *others) or _shows_by_type(view, aspect):
            pattern = _pattern(view) if view.is_below_pattern else view.topic
            below.setdefault(pattern, []).append(view)
    for found in below.values():
        hint, suggestions = coarsening(found[0])
        message = f"{_begin(coarse)}, but {', '.join(view.topic for view in found)} exactly"
        yield Finding(coarse.rule.line, "exact-relative", message, hint, suggestions)


def _shows_by_type(view: View, aspect: Aspect) -> bool:
    """A cloud of points beside a picture, the climate beside a position."""
    if aspect is Aspect.IMAGE:
        return view.shows_depth
    return aspect is Aspect.POSITION and view.shows_climate


def _pattern(view: View) -> str:
    """The pattern by which the topic is seen."""
    return view.verdict.clauses[0].pattern


def _same_type(one: View, other: View) -> bool:
    """Whether two topics have one type: names of joints are not those of devices."""
    return one.layout is not None and one.layout is other.layout


def _begin(coarse: View) -> str:
    return f"rule {coarse.rule.id}: {coarse.receiver.label} sees {coarse.topic} coarsely"


def _unknown(view: View) -> str:
    if view.layout is None:
        return "of which no type is given"
    return f"and of {view.layout.type_name} nothing is known here"


def _judge(view: View) -> str:
    if "*" in view.topic:
        return "name the topics it needs, with their types"
    if view.layout is None:
        return f"add its type to types: {{{view.topic}: package/Type}}"
    kind = view.layout.type_name
    return f"say what it tells: vocabulary: {{{kind}: {{FIELD: WORD}}}}, or withhold {view.topic}"


def _is_own(view: View) -> bool:
    """Whether the topic is below the receiver's name: what comes there is sent for it."""
    return view.topic.startswith(f"{view.receiver.subject.name}/")


def second_receivers(scene: Scene) -> Iterator[Finding]:
    """Nodes of one owner, of which one sees exactly what the other sees coarsely."""
    for one, other in _of_one_owner(list(scene.views)):
        coarse = _first_treated(scene.views[one], Aspect.POSITION)
        if coarse is None or _first_treated(scene.views[other], Aspect.POSITION) is not None:
            continue  # two versions, or an exact relative of the other itself
        known = {view.topic for view in scene.views[one]} - {coarse.topic}
        for view in scene.views[other]:
            shows = view.shows(Aspect.POSITION, *_SHOWN_BY[Aspect.POSITION])
            if shows and view.topic not in known:
                hint, suggestions = coarsening(view)
                message = (
                    f"rule {coarse.rule.id}: {one.label} sees {coarse.topic} coarsely, but"
                    f" {other.label}, of the same owner, sees {view.topic} exactly"
                )
                line = coarse.rule.line
                yield Finding(line, "second-receiver", message, hint, suggestions)


def versions(scene: Scene) -> Iterator[Finding]:
    """Two grids of one position, of which one is not a multiple of the other."""
    grids = {receiver: list(_grids(views)) for receiver, views in scene.views.items()}
    gridded = [receiver for receiver, found in grids.items() if found]
    for one, other in (*zip(gridded, gridded, strict=True), *_of_one_owner(gridded)):
        for (first, step), (second, other_step) in product(grids[one], grids[other]):
            here, there = (one.subject.name, first.topic), (other.subject.name, second.topic)
            small, large = sorted((step, other_step))
            if here < there and _differ(first, second):
                message = (
                    f"rule {first.rule.id}: {one.label} sees {first.topic}, {other.label}"
                    f" {second.topic}, in cells that do not lie on each other: together they are"
                    " finer"
                )
                hint = "use one frame and one plan of rooms for both"
                yield Finding(first.rule.line, "two-versions", message, hint)
            elif here < there and small > 0 and not (large / small).is_integer():
                message = (
                    f"rule {first.rule.id}: {one.label} sees {first.topic} in steps of"
                    f" {step:g}, {other.label} {second.topic} in steps of {other_step:g}:"
                    " together they are finer"
                )
                hint = "use the same step for both, or a multiple of it"
                yield Finding(first.rule.line, "two-versions", message, hint)


def _grids(views: Iterable[View]) -> Iterator[tuple[View, float]]:
    """The views with a coarse position, and the step; of rooms 0."""
    for view in views:
        if (step := _step(view)) or _plan(view):
            yield view, step


def _differ(one: View, other: View) -> bool:
    """Whether the cells are of two plans of rooms, or of two frames by the conditions of each."""
    plans = _plan(one), _plan(other)
    frames = _frames(one), _frames(other)
    return (all(plans) and plans[0] != plans[1]) or (all(frames) and not frames[0] & frames[1])


def _plan(view: View) -> frozenset[tuple[str, Scalar]]:
    """The rooms of a position; empty if it has none."""
    for path in view.coarse(Aspect.POSITION):
        rule = view.filter_on(path)
        if rule.operator == "rooms":
            return frozenset(item for item in rule.parameters if item[0] != "hysteresis")
    return frozenset()


def _frames(view: View) -> frozenset[str]:
    """The frames that conditions let through; empty if they name none."""
    texts = (text for item in view.verdict.restrictions for text in item.conditions)
    return frozenset(name for text in texts for _, name in _FRAME.findall(text))


def _step(view: View) -> float:
    """The step in which the position is rounded; 0 if it is not."""
    for path in view.coarse(Aspect.POSITION):
        step = dict(view.filter_on(path).parameters).get("step")
        if isinstance(step, int | float):
            return step
    return 0.0


def _of_one_owner(receivers: list[Receiver]) -> Iterator[tuple[Receiver, Receiver]]:
    """All pairs of receivers, in both orders, that belong to one owner."""
    owned: dict[object, list[Receiver]] = {}
    below: dict[str, list[Receiver]] = {}
    for receiver in receivers:
        for owner in _owners(receiver):
            owned.setdefault(owner, []).append(receiver)
        for name in _names_above(receiver):
            below.setdefault(name, []).append(receiver)
    pairs = [pair for together in owned.values() for pair in permutations(together, 2)]
    for receiver in receivers:
        for other in below.get(receiver.subject.name, ()):
            pairs += [(receiver, other), (other, receiver)]
    for one, other in dict.fromkeys(pairs):
        if one.subject.name != other.subject.name:
            yield one, other


def _owners(receiver: Receiver) -> Iterator[object]:
    """The pinned key, and the foreign domain."""
    if any(receiver.subject.key):  # else none is pinned
        yield receiver.subject.key
    if is_alias(receiver.subject.name):
        yield tuple(receiver.subject.name.split("/")[:3])  # /remote/LABEL


def _names_above(receiver: Receiver) -> Iterator[str]:
    name = receiver.subject.name
    while not is_alias(name) and (name := name.rpartition("/")[0]):
        yield name


def pseudonyms(scene: Scene) -> Iterator[Finding]:
    """Pseudonyms under one key for two receivers; `per: receiver` makes a key for each."""
    first: dict[object, View] = {}
    for views in scene.views.values():
        for view in views:
            for rule in view.filters:
                key = dict(rule.parameters).get("key")
                if rule.operator != "hash" or "per" in dict(rule.parameters):
                    continue
                other = first.setdefault(key, view)
                if other.receiver.subject.name != view.receiver.subject.name:
                    yield _shared(other, view, rule)
                elif "*" in (view.receiver.who.node or "*"):
                    yield _shared(view, view, rule)


def _shared(one: View, other: View, rule: FilterRule) -> Finding:
    better = FilterRule(
        rule.path, "hash", tuple(sorted((dict(rule.parameters) | {"per": "receiver"}).items()))
    )
    hint, suggestions = replacing(other, rule, better)
    place, _ = other.place(rule)
    both = f"{one.receiver.label} and {other.receiver.label}"
    if one is other:
        both = f"all of {one.receiver.label}"
    message = f"rule {place.id}: {both} get the same pseudonyms for {rule.path} of {other.topic}"
    return Finding(place.line, "shared-pseudonym", message, f"write {hint}", suggestions)


def wheels(scene: Scene) -> Iterator[Finding]:
    """Joints in steps beside a coarse position: if they are wheels, their turns are the path."""
    for views in scene.views.values():
        coarse = _first_treated(views, Aspect.POSITION)
        for view in views if coarse is not None else ():
            found = view.coarse(Aspect.JOINT)
            if coarse is not None and found:
                message = f"{_begin(coarse)}, and joints of {view.topic} in steps: wheels tell it"
                old = view.filter_on(found[0])
                hint, suggestions = replacing(view, old, FilterRule(old.path, "clear"))
                line = coarse.rule.line
                yield Finding(line, "wheels-open", message, f"write {hint}", suggestions)
