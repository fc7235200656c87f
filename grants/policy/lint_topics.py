"""Advice on what else tells what is hidden: fields beside it, other topics, services, other receivers.

The attackers' figures are in docs/spec/policy.md, "Lint".
"""

import re
from collections.abc import Iterable, Iterator
from itertools import permutations, product
from typing import Final, NamedTuple

from ca.names import is_alias
from grants.filters.layout import Array
from grants.model import FilterRule, Right, Scalar
from grants.policy.lint_findings import LintFinding, closing, closing_all, coarsening, replacing
from grants.policy.lint_views import Aspect, LintedPolicy, LintReceiver, View, conventional

_PLACES: Final = (Aspect.POSITION, Aspect.JOINT)
# A rounded position with an exact twist is the path to 0.05 m; a rounded joint with an exact velocity is the
# joint.
_INTEGRATED: Final = ("movement-open", "the exact path follows from it by integration")
_BESIDE: Final[dict[Aspect, tuple[str, str]]] = {
    Aspect.MOVEMENT: _INTEGRATED,
    Aspect.JOINT_RATE: _INTEGRATED,
    Aspect.COVARIANCE: ("covariance-open", "it reveals the precision of the hidden value"),
    Aspect.HEADING: ("heading-open", "turns reveal the direction of movement"),
    Aspect.TIME: ("time-open", "the exact time of a cell change reveals the exact position"),
    Aspect.COUNT: ("time-open", "counting messages reveals the exact time"),
}
_CELLS: Final = (Aspect.TIME, Aspect.COUNT)  # without a value there are no cells to change


def beside_position(linted: LintedPolicy) -> Iterator[LintFinding]:
    for view in _views(linted):
        treated = view.treated(*_PLACES)
        coarse = view.coarse(*_PLACES)
        for aspect, (code, why) in _BESIDE.items() if treated else ():
            open_fields = view.exact(aspect)
            if open_fields and (coarse or aspect not in _CELLS):
                yield _open(view, code, treated[0], open_fields, why)


def other_coordinates(linted: LintedPolicy) -> Iterator[LintFinding]:
    """One coordinate filtered, another not; a height indoors does not change."""
    for view in _views(linted):
        treated = view.treated(Aspect.POSITION)
        rest = [path for path in view.exact(Aspect.POSITION) if not path.endswith(".z")]
        if treated and rest:
            yield _open(view, "position-open", treated[0], rest, "it shows the place as well")


def other_names(linted: LintedPolicy) -> Iterator[LintFinding]:
    for view in _views(linted):
        treated, rest = view.treated(Aspect.NAME), view.exact(Aspect.NAME)
        if treated and rest:
            why = "a name that occurs once links all that is said of it"
            yield _open(view, "name-open", treated[0], rest, why)


def _views(linted: LintedPolicy) -> Iterator[View]:
    return (view for views in linted.views.values() for view in views if view.filters)


def _open(view: View, code: str, hidden: str, open_fields: list[str], why: str) -> LintFinding:
    path, text, suggestions = closing(view, open_fields)
    rule = view.rule
    filtered = view.filter_on(hidden).path
    what = f"{filtered} of {view.topic} is filtered, {path} is not: {why}"
    return LintFinding(rule.line, code, f"rule {rule.id}: {what}", f"add {text}", suggestions)


class Related(NamedTuple):
    own: tuple[Aspect, ...]
    told_by: tuple[Aspect, ...]


# A treated kind is given away by an exact one of its row.
_MOVES: Final = (Aspect.MOVEMENT, Aspect.JOINT_RATE, Aspect.JOINT)
RELATED: Final[tuple[Related, ...]] = (
    Related(
        _MOVES, (*_MOVES, Aspect.POSITION, Aspect.HEADING, Aspect.SURROUNDINGS, Aspect.IMAGE, Aspect.STATE)
    ),
    Related((Aspect.SOUND,), (Aspect.SOUND,)),
    Related((Aspect.WARMTH,), (Aspect.WARMTH, Aspect.HUMIDITY)),
    Related((Aspect.HUMIDITY,), (Aspect.HUMIDITY, Aspect.WARMTH)),
    Related((Aspect.LIGHT,), (Aspect.LIGHT, Aspect.IMAGE)),
    Related((Aspect.STATE,), (Aspect.STATE,)),
    Related((Aspect.PLAN,), (Aspect.PLAN, Aspect.SURROUNDINGS)),
    Related((Aspect.NAME,), (Aspect.NAME, Aspect.MARK)),
)
# Services by the last segment of their names: a policy says no types of services.
_ASKED: Final = frozenset(
    (
        *("make_plan", "get_plan", "get_map", "static_map", "dynamic_map", "get_pose", "get_robot_pose"),
        *("current_pose", "get_odom", "get_model_state", "get_link_state", "get_costmap", "get_path"),
        *("get_state", "lookup_transform", "tf2_frames"),
    )
)
_EVERYWHERE: Final = (
    *("/move_base/make_plan", "/static_map", "/dynamic_map", "/map_server/get_map"),
    *("/gazebo/get_model_state", "/tf2_frames"),
)


def related(linted: LintedPolicy) -> Iterator[LintFinding]:
    for views in linted.views.values():
        found: dict[tuple[str, str], tuple[View, View, list[str]]] = {}
        for row in RELATED:
            hidden = next((view for view in views if _is_hidden(view, row)), None)
            if hidden is None:
                continue
            for view in views:
                if view is not hidden and (told := _told(view, row, hidden)):
                    pair = hidden.topic, view.topic
                    found.setdefault(pair, (hidden, view, []))[2].extend(told)
        for hidden, view, told in found.values():
            hint, suggestions = closing_all(view, told)
            message = f"{_begin(hidden)}, but {view.topic} exactly"
            yield LintFinding(hidden.rule.line, "exact-relative", message, hint, suggestions)


def _is_hidden(view: View, row: Related) -> bool:
    if row.own == _MOVES and view.treated(Aspect.POSITION):
        return False  # that of a position
    told = row.own if row.own == (Aspect.NAME,) else row.told_by  # marks of a device are beside
    return bool(_of_devices(view, view.treated(*row.own), row)) and not _of_devices(
        view, view.exact(*told), row
    )


def _told(view: View, row: Related, hidden: View) -> list[str]:
    if view.treated(*row.own):
        return []
    if row.own == (Aspect.STATE,) and view.layout is not hidden.layout:
        return []  # the state of a battery is not that of a task
    if row.own == (Aspect.NAME,) and view.layout is hidden.layout:
        return []  # `lint_relatives` says it
    return _of_devices(view, view.exact(*row.told_by), row)


def _of_devices(view: View, paths: list[str], row: Related) -> list[str]:
    # Without lists of names, as of joints: those are not the names of devices.
    if row.own != (Aspect.NAME,) or view.described is None:
        return paths
    arrays = {field.path for field in view.described.fields if isinstance(field.kind, Array)}
    return [path for path in paths if path not in arrays or view.aspects[path] is not Aspect.NAME]


def _begin(view: View, how: str = "coarsely") -> str:
    return f"rule {view.rule.id}: {view.receiver.label} sees {view.topic} {how}"


def presence(linted: LintedPolicy) -> Iterator[LintFinding]:
    """Topics of the same place that are not in slots, beside one that is."""
    for views in linted.views.values():
        slotted = next((view for view in views if view.hides_presence), None)
        for view in views if slotted is not None else ():
            # Those of one robot, by the folder of their names; not what tells nothing.
            silent = conventional(view.topic) is Aspect.NOTHING or "*" in view.topic
            if slotted is None or view.has_slot or silent:
                continue
            mine, other = (f"{each.topic.rpartition('/')[0]}/" for each in (view, slotted))
            sent_for_it = view.topic.startswith(f"{view.receiver.subject.name}/")
            if sent_for_it or not (mine.startswith(other) or other.startswith(mine)):
                continue
            message = f"{_begin(slotted, 'in slots')}, but messages of {view.topic} as they come"
            hint = f"filter {view.topic} as well: {{use: presence-only}}"
            yield LintFinding(slotted.rule.line, "presence-open", message, hint)


def services(linted: LintedPolicy) -> Iterator[LintFinding]:
    for receiver, _, coarse in _coarse(linted, Aspect.POSITION):
        named = {
            found.pattern
            for rule in linted.decider.rules_of(receiver.subject)
            for clause in rule.clauses
            if clause.right is Right.CALL and (found := clause.of(receiver.subject)) is not None
        }
        told = {name for name in named if name.rpartition("/")[2] in _ASKED and "*" not in name}
        for name in sorted(told | set(_EVERYWHERE)):
            verdict = linted.decider.decide(receiver.subject, Right.CALL, name)
            if verdict and not name.startswith(f"{receiver.subject.name}/"):
                message = f"{_begin(coarse)}, but may call {name}, which tells it"
                hint = f"take {verdict.clauses[0].pattern} out, or name the services it needs"
                yield LintFinding(verdict.rules[0].line, "service-tells", message, hint)


def graph(linted: LintedPolicy) -> Iterator[LintFinding]:
    """The right to see the graph: who publishes, since when, how many messages, also withheld."""
    for receiver, views in linted.views.items():
        hidden = next((view for view in views if view.has_slot or view.treated(Aspect.NAME)), None)
        coarse = hidden or _first_treated(views, Aspect.POSITION)
        if coarse is None:
            continue
        verdict = linted.decider.decide(receiver.subject, Right.GRAPH, coarse.topic)
        if verdict:
            told = "who publishes it, when, and how many messages"
            message = f"{_begin(coarse)}, but its right to the graph tells {told}"
            hint = "take the graph right out, or limit it to other names"
            yield LintFinding(verdict.rules[0].line, "graph-tells", message, hint)


_FRAME: Final = re.compile(r"""frame_id\s*==\s*(["'])([^"']*)\1""")
SAVED_POSE: Final = "/amcl/initial_pose_x"
# A treated aspect, and what else gives it away if it is seen exactly on another topic.
_SHOWN_BY: Final[dict[Aspect, tuple[Aspect, ...]]] = {
    Aspect.POSITION: (
        *(Aspect.MOVEMENT, Aspect.SURROUNDINGS, Aspect.IMAGE, Aspect.JOINT, Aspect.JOINT_RATE),
        *(Aspect.HEADING, Aspect.STATE),
    ),
    Aspect.IMAGE: (),
    Aspect.NAME: (),
}


def relatives(linted: LintedPolicy) -> Iterator[LintFinding]:
    for views in linted.views.values():
        for aspect, others in _SHOWN_BY.items():
            if (coarse := _first_treated(views, aspect)) is not None:
                yield from _exact(coarse, views, aspect, others)


def saved_poses(linted: LintedPolicy) -> Iterator[LintFinding]:
    """The parameter in which localisation saves where the robot is, twice a second."""
    for receiver, _, coarse in _coarse(linted, Aspect.POSITION):
        verdict = linted.decider.decide(receiver.subject, Right.PARAM_GET, SAVED_POSE)
        if verdict:
            message = f"{_begin(coarse)}, but may read {SAVED_POSE}, where amcl saves the position"
            hint = f"name the parameters it needs instead of {verdict.clauses[0].pattern}"
            yield LintFinding(verdict.rules[0].line, "exact-relative", message, hint)


def unknown(linted: LintedPolicy) -> Iterator[LintFinding]:
    for _, views, coarse in _coarse(linted, Aspect.POSITION, Aspect.IMAGE):
        told = {view.pattern for view in views if view.is_below_pattern}
        for view in views:
            is_own = view.topic.startswith(f"{view.receiver.subject.name}/")
            if view.is_known or is_own or view.topic in told:
                continue
            if view.layout is None:
                what = "of which no type is given"
                hint = f"add its type to types: {{{view.topic}: package/Type}}"
            else:
                kind = view.layout.type_name
                what = f"and of {kind} nothing is known here"
                hint = f"say what it tells: vocabulary: {{{kind}: {{FIELD: WORD}}}}, or withhold {view.topic}"
            if "*" in view.topic:
                hint = "name the topics it needs, with their types"
            message = f"{_begin(coarse)}, and {view.topic}, {what}"
            yield LintFinding(coarse.rule.line, "unknown-type", message, hint)


def _first_treated(views: Iterable[View], *aspects: Aspect) -> View | None:
    return next((view for view in views if view.treated(*aspects)), None)


def _coarse(linted: LintedPolicy, *aspects: Aspect) -> Iterator[tuple[LintReceiver, list[View], View]]:
    # The receivers to whom a treated topic is to hide one of `aspects`, and the first such topic.
    for receiver, views in linted.views.items():
        if (coarse := _first_treated(views, *aspects)) is not None:
            yield receiver, views, coarse


def _exact(
    coarse: View, views: Iterable[View], aspect: Aspect, others: tuple[Aspect, ...]
) -> Iterator[LintFinding]:
    below: dict[str, list[View]] = {}
    for view in views:
        if view is coarse or (aspect is Aspect.NAME and view.layout is not coarse.layout):
            continue  # names of joints are not those of devices
        by_type = aspect is Aspect.POSITION and view.shows_climate
        if view.shows(aspect, *others) or by_type or (aspect is Aspect.IMAGE and view.shows_depth):
            below.setdefault(view.pattern if view.is_below_pattern else view.topic, []).append(view)
    for found in below.values():
        hint, suggestions = coarsening(found[0])
        message = f"{_begin(coarse)}, but {', '.join(view.topic for view in found)} exactly"
        yield LintFinding(coarse.rule.line, "exact-relative", message, hint, suggestions)


def second_receivers(linted: LintedPolicy) -> Iterator[LintFinding]:
    for one, other in _of_one_owner(list(linted.views)):
        coarse = _first_treated(linted.views[one], Aspect.POSITION)
        if coarse is None or _first_treated(linted.views[other], Aspect.POSITION) is not None:
            continue  # two versions, or an exact relative of the other itself
        known = {view.topic for view in linted.views[one]} - {coarse.topic}
        for view in linted.views[other]:
            shows = view.shows(Aspect.POSITION, *_SHOWN_BY[Aspect.POSITION])
            if shows and view.topic not in known:
                hint, suggestions = coarsening(view)
                message = f"{_begin(coarse)}, but {other.label}, of the same owner, sees {view.topic} exactly"
                yield LintFinding(coarse.rule.line, "second-receiver", message, hint, suggestions)


def versions(linted: LintedPolicy) -> Iterator[LintFinding]:
    """Two grids of one position, of which one is not a multiple of the other."""
    grids = {
        receiver: [(view, _step(view)) for view in views if _step(view) or _plan(view)]
        for receiver, views in linted.views.items()
    }
    gridded = [receiver for receiver, found in grids.items() if found]
    for one, other in (*zip(gridded, gridded, strict=True), *_of_one_owner(gridded)):
        for (first, step), (second, other_step) in product(grids[one], grids[other]):
            here, there = (one.subject.name, first.topic), (other.subject.name, second.topic)
            if here >= there:
                continue
            small, large = sorted((step, other_step))
            begin = f"rule {first.rule.id}: {one.label} sees {first.topic}"
            plans, frames = (_plan(first), _plan(second)), (_frames(first), _frames(second))
            apart = (all(plans) and plans[0] != plans[1]) or (all(frames) and not frames[0] & frames[1])
            if apart:
                cells = "in cells that do not lie on each other: together they are finer"
                message = f"{begin}, {other.label} {second.topic}, {cells}"
                hint = "use one frame and one plan of rooms for both"
                yield LintFinding(first.rule.line, "two-versions", message, hint)
            elif small > 0 and not (large / small).is_integer():
                theirs = f"{other.label} {second.topic} in steps of {other_step:g}: together they are finer"
                hint = "use the same step for both, or a multiple of it"
                message = f"{begin} in steps of {step:g}, {theirs}"
                yield LintFinding(first.rule.line, "two-versions", message, hint)


def _plan(view: View) -> frozenset[tuple[str, Scalar]]:
    for path in view.coarse(Aspect.POSITION):
        rule = view.filter_on(path)
        if rule.operator == "rooms":
            return frozenset(item for item in rule.parameters if item[0] != "hysteresis")
    return frozenset()


def _frames(view: View) -> frozenset[str]:
    texts = (text for item in view.verdict.restrictions for text in item.conditions)
    return frozenset(name for text in texts for _, name in _FRAME.findall(text))


def _step(view: View) -> float:
    for path in view.coarse(Aspect.POSITION):
        step = dict(view.filter_on(path).parameters).get("step")
        if isinstance(step, int | float):
            return step
    return 0.0


def _of_one_owner(receivers: list[LintReceiver]) -> Iterator[tuple[LintReceiver, LintReceiver]]:
    # Two nodes are of one owner if they have one key, are of one foreign domain, or one is below the
    # other's name: what one of them sees, the other knows.
    owned: dict[object, list[LintReceiver]] = {}
    below: dict[str, list[LintReceiver]] = {}
    for receiver in receivers:
        name = receiver.subject.name
        if any(receiver.subject.key):  # else none is pinned
            owned.setdefault(receiver.subject.key, []).append(receiver)
        if is_alias(name):
            owned.setdefault(tuple(name.split("/")[:3]), []).append(receiver)  # /remote/LABEL
        while not is_alias(name) and (name := name.rpartition("/")[0]):
            below.setdefault(name, []).append(receiver)
    pairs = [pair for together in owned.values() for pair in permutations(together, 2)]
    for receiver in receivers:
        for other in below.get(receiver.subject.name, ()):
            pairs += [(receiver, other), (other, receiver)]
    for one, other in dict.fromkeys(pairs):
        if one.subject.name != other.subject.name:
            yield one, other


def pseudonyms(linted: LintedPolicy) -> Iterator[LintFinding]:
    first: dict[object, View] = {}
    for views in linted.views.values():
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


def _shared(one: View, other: View, rule: FilterRule) -> LintFinding:
    parameters = dict(rule.parameters) | {"per": "receiver"}
    better = FilterRule(rule.path, "hash", tuple(sorted(parameters.items())))
    hint, suggestions = replacing(other, rule, better)
    place, _ = other.place(rule)
    one_label = one.receiver.label
    both = f"all of {one_label}" if one is other else f"{one_label} and {other.receiver.label}"
    message = f"rule {place.id}: {both} get the same pseudonyms for {rule.path} of {other.topic}"
    return LintFinding(place.line, "shared-pseudonym", message, f"write {hint}", suggestions)


def wheels(linted: LintedPolicy) -> Iterator[LintFinding]:
    for _, views, coarse in _coarse(linted, Aspect.POSITION):
        for view in views:
            if found := view.coarse(Aspect.JOINT):
                message = f"{_begin(coarse)}, and joints of {view.topic} in steps: wheels tell it"
                old = view.filter_on(found[0])
                hint, suggestions = replacing(view, old, FilterRule(old.path, "clear"))
                yield LintFinding(coarse.rule.line, "wheels-open", message, f"write {hint}", suggestions)
