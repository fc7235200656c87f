"""Advice on what else tells the movement, the sound, the home, names or presence that is hidden.

Of a position `lint_relatives` says it. What tells what is data: a treated kind is given away by an
exact one of its row, on any other topic of the same receiver.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from grants.filters.layout import Array
from grants.model import Right
from grants.policy.lint_facts import Aspect, conventional
from grants.policy.lint_findings import Finding
from grants.policy.lint_suggest import closing_all
from grants.policy.lint_views import Receiver, Scene, View


class Related(NamedTuple):
    """A kind of data, and what gives it away on another topic if it is seen exactly there."""

    own: tuple[Aspect, ...]
    told_by: tuple[Aspect, ...]


_MOVES: Final = (Aspect.MOVEMENT, Aspect.JOINT_RATE, Aspect.JOINT)
RELATED: Final[tuple[Related, ...]] = (
    Related(
        _MOVES,
        (*_MOVES, Aspect.POSITION, Aspect.HEADING, Aspect.SURROUNDINGS, Aspect.IMAGE, Aspect.STATE),
    ),
    Related((Aspect.SOUND,), (Aspect.SOUND,)),
    Related((Aspect.WARMTH,), (Aspect.WARMTH, Aspect.HUMIDITY)),
    Related((Aspect.HUMIDITY,), (Aspect.HUMIDITY, Aspect.WARMTH)),
    Related((Aspect.LIGHT,), (Aspect.LIGHT, Aspect.IMAGE)),
    Related((Aspect.STATE,), (Aspect.STATE,)),
    Related((Aspect.PLAN,), (Aspect.PLAN, Aspect.SURROUNDINGS)),
    Related((Aspect.NAME,), (Aspect.NAME, Aspect.MARK)),
)
_ASKED: Final = frozenset({
    "make_plan", "get_plan", "get_map", "static_map", "dynamic_map", "get_pose", "get_robot_pose",
    "current_pose", "get_odom", "get_model_state", "get_link_state", "get_costmap", "get_path",
    "get_state", "lookup_transform", "tf2_frames",
})  # fmt: skip
"""Services by the last segment of their names: a policy says no types of services."""
_EVERYWHERE: Final = (
    "/move_base/make_plan", "/static_map", "/dynamic_map", "/map_server/get_map",
    "/gazebo/get_model_state", "/tf2_frames",
)  # fmt: skip


def related(scene: Scene) -> Iterator[Finding]:
    """What a receiver sees exactly beside something of the same row that is hidden."""
    for views in scene.views.values():
        found: dict[tuple[str, str], tuple[View, View, list[str]]] = {}
        for row in RELATED:
            hidden = next((view for view in views if _is_hidden(view, row)), None)
            for view in views if hidden is not None else ():
                if hidden is not None and view is not hidden and (told := _told(view, row, hidden)):
                    pair = hidden.topic, view.topic
                    found.setdefault(pair, (hidden, view, []))[2].extend(told)
        for hidden, view, told in found.values():
            yield _given_away(hidden, view, told)


def _is_hidden(view: View, row: Related) -> bool:
    """Whether the view hides what the row is about, and shows nothing that tells it."""
    if row.own == _MOVES and view.treated(Aspect.POSITION):
        return False  # that of a position
    told = row.own if row.own == (Aspect.NAME,) else row.told_by  # marks of a device are beside
    hidden, shown = (
        [path for path in paths if not _is_list(view, path, row)]
        for paths in (view.treated(*row.own), view.exact(*told))
    )
    return bool(hidden) and not shown


def _told(view: View, row: Related, hidden: View) -> list[str]:
    """The leaves of another topic that give it away."""
    if view.treated(*row.own):
        return []
    if row.own == (Aspect.STATE,) and view.layout is not hidden.layout:
        return []  # the state of a battery is not that of a task
    if row.own == (Aspect.NAME,) and view.layout is hidden.layout:
        return []  # `lint_relatives` says it
    return [path for path in view.exact(*row.told_by) if not _is_list(view, path, row)]


def _is_list(view: View, path: str, row: Related) -> bool:
    """Whether it is a list of names, as of joints: those are not the names of devices."""
    fields = view.described.fields if view.described is not None else ()
    return row.own == (Aspect.NAME,) and any(
        field.path == path and isinstance(field.kind, Array) and view.aspects[path] is Aspect.NAME
        for field in fields
    )


def _given_away(hidden: View, view: View, told: list[str]) -> Finding:
    hint, suggestions = closing_all(view, told)
    message = f"{_begin(hidden)}, but {view.topic} exactly"
    return Finding(hidden.rule.line, "exact-relative", message, hint, suggestions)


def _begin(view: View) -> str:
    return f"rule {view.rule.id}: {view.receiver.label} sees {view.topic} coarsely"


def presence(scene: Scene) -> Iterator[Finding]:
    """Topics of the same place that are not in slots, beside one that is."""
    for views in scene.views.values():
        slotted = next((view for view in views if view.hides_presence), None)
        for view in views if slotted is not None else ():
            if slotted is None or view.has_slot or not _is_beside(view, slotted):
                continue
            message = (
                f"rule {slotted.rule.id}: {slotted.receiver.label} sees {slotted.topic} in slots,"
                f" but messages of {view.topic} as they come"
            )
            hint = f"filter {view.topic} as well: {{use: presence-only}}"
            yield Finding(slotted.rule.line, "presence-open", message, hint)


def _is_beside(view: View, slotted: View) -> bool:
    """Whether both are of one robot, by the folder of their names; not what tells nothing."""
    if conventional(view.topic) is Aspect.NOTHING or "*" in view.topic:
        return False
    mine, other = (each.topic.rpartition("/")[0] for each in (view, slotted))
    sent_for_it = view.topic.startswith(f"{view.receiver.subject.name}/")
    return not sent_for_it and (
        f"{mine}/".startswith(f"{other}/") or f"{other}/".startswith(f"{mine}/")
    )


def services(scene: Scene) -> Iterator[Finding]:
    """Services that answer with the pose, the way or the map, beside a coarse position."""
    for receiver, views in scene.views.items():
        coarse = next((view for view in views if view.treated(Aspect.POSITION)), None)
        for name in _callable(scene, receiver) if coarse is not None else ():
            verdict = scene.decider.decide(receiver.subject, Right.CALL, name)
            if coarse is not None and verdict:
                message = f"{_begin(coarse)}, but may call {name}, which tells it"
                hint = f"take {verdict.clauses[0].pattern} out, or name the services it needs"
                yield Finding(verdict.rules[0].line, "service-tells", message, hint)


def _callable(scene: Scene, receiver: Receiver) -> list[str]:
    """The services that rules name, and usual ones: patterns may cover them."""
    own = f"{receiver.subject.name}/"
    named = {
        found.pattern
        for rule in scene.decider.rules_of(receiver.subject)
        for clause in rule.clauses
        if clause.right is Right.CALL and (found := clause.of(receiver.subject)) is not None
    }
    told = {name for name in named if name.rpartition("/")[2] in _ASKED and "*" not in name}
    return sorted(name for name in told | set(_EVERYWHERE) if not name.startswith(own))


def graph(scene: Scene) -> Iterator[Finding]:
    """The right to see the graph: who publishes, since when, how many messages, also withheld."""
    for receiver, views in scene.views.items():
        hidden = next((view for view in views if view.has_slot or view.treated(Aspect.NAME)), None)
        coarse = hidden or next((view for view in views if view.treated(Aspect.POSITION)), None)
        if coarse is None:
            continue
        verdict = scene.decider.decide(receiver.subject, Right.GRAPH, coarse.topic)
        if verdict:
            message = (
                f"{_begin(coarse)}, but its right to the graph tells who publishes it, when, and"
                " how many messages"
            )
            hint = "take the graph right out, or limit it to other names"
            yield Finding(verdict.rules[0].line, "graph-tells", message, hint)
