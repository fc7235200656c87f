"""The options of `rossec grant sign` as permissions: rights, conditions and filters."""

import itertools
from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, Final

import click

from ca.errors import PatternRefused
from grants.conditions.compile import compile_condition
from grants.errors import ConditionRefused, FilterRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import parse
from grants.filters.presets import PRESETS, preset
from grants.model import Permission, Restriction, Right, filter_rules
from grants.policy.own_names import NODE, check_rule_pattern, resolve
from rossec.errors import ConfigurationError
from rossec.participant.service_types import part_type

_EXAMPLES: Final = (
    "for example --clear header.frame_id, --round pose.position=2.0,"
    " --when 'msg.header.frame_id == \"map\"'"
)

_RIGHTS: Final = {
    Right.PUBLISH: "may publish these topics",
    Right.SUBSCRIBE: "may subscribe to these topics",
    Right.CALL: "may call these services",
    Right.PROVIDE: "may provide these services",
    Right.PARAM_GET: "may read these parameters and all below",
    Right.PARAM_SET: "may set these parameters and all below",
    Right.ADMIN: "may end these nodes and clean up after them",
}
_RESTRICTED: Final = Right.SUBSCRIBE | Right.CALL  # by conditions and filters given here


def _once(_context: click.Context, _parameter: click.Parameter, given: tuple[Any, ...]) -> Any:
    """The value of an option that is given once: of two click would lose the first."""
    if len(given) > 1:
        raise click.BadParameter("given more than once, and one would be lost")
    return given[0] if given else None


_RESTRICTING: Final = (
    click.option("--graph", is_flag=True, help="may see the whole ROS graph"),
    click.option(
        "--type", "type_name", multiple=True, callback=_once, metavar="PKG/TYPE",
        help="message type of the restrictions",
    ),
    click.option("--clear", multiple=True, metavar="FIELD", help="clear this field"),
    click.option("--round", "rounds", multiple=True, metavar="FIELD=STEP", help="round this field"),
    click.option(
        "--clamp", "clamps", multiple=True, metavar="FIELD=LOW:HIGH",
        help="keep this field in a range",
    ),
    click.option(
        "--rate", type=float, multiple=True, callback=_once, metavar="HZ",
        help="at most so many messages a second",
    ),
    click.option(
        "--preset", "preset_name", type=click.Choice(list(PRESETS)), multiple=True, callback=_once,
        help="restrictions for a usual wish; see `rossec grant presets`",
    ),
    click.option(
        "--when", multiple=True, metavar="CONDITION",
        help="only messages and times for which this holds",
    ),
)  # fmt: skip


def wishes(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add every option for rights and their restrictions; `read` takes what they say."""
    for option in reversed(_RESTRICTING):
        command = option(command)
    return rights(command)


def own_pattern(text: str, node: str, *, tail: bool) -> str:
    """The pattern that `{node}/pose` is for `node`; every other one is returned as it is.

    Raises:
        PatternRefused: not a pattern, or none for this node.
    """
    if not is_own_text(text):
        return text
    found = resolve(check_rule_pattern(text), node, tail=tail)
    if found is None:
        raise PatternRefused(f"{text[:80]!a} is no name of {node}", "its own authority grants it")
    return found


def read(said: Mapping[str, Any]) -> tuple[Permission, ...]:
    """The permissions that the options of `wishes` say.

    Raises:
        ConfigurationError: no right is given, or an invalid parameter.
        ConditionRefused, FilterRefused: a restriction that does not fit the message type.
    """
    filters = rules(said["clear"], said["rounds"], said["clamps"])
    inside = restrictions(
        said["type_name"], filters, said["when"], said["rate"], said["preset_name"]
    )
    return permissions(patterns_by_right(said), graph=said["graph"], restricted=inside)


def rights(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add an option for every right over names: `--publish`, `--param-get` and so on."""
    for right, help_text in reversed(_RIGHTS.items()):
        command = click.option(
            f"--{right.label}", multiple=True, metavar="PATTERN", help=help_text
        )(command)
    return command


def for_node(said: Mapping[str, Any], node: str, tail: Callable[[], bool]) -> dict[str, Any]:
    """What `wishes` say, with own names as those of `node`.

    Args:
        tail: asked only if there are own names: whether the node has a wildcard tail.

    Raises:
        PatternRefused: as `own_pattern`.
    """
    named = patterns_by_right(said)
    if not any(is_own_text(each) for each in itertools.chain(*named.values())):
        return dict(said)
    has_tail = tail()
    own = {
        str(right.name).lower(): tuple(own_pattern(each, node, tail=has_tail) for each in patterns)
        for right, patterns in named.items()
    }
    return {**said, **own}


def is_own_text(text: str) -> bool:
    """Whether it is meant as an own name, well-formed or not."""
    return NODE in text or text.startswith("~")


def patterns_by_right(options: Mapping[str, Any]) -> dict[Right, tuple[str, ...]]:
    """The patterns given with these options, by right."""
    return {right: options[str(right.name).lower()] for right in _RIGHTS}


def rules(
    clear: tuple[str, ...], rounds: tuple[str, ...], clamps: tuple[str, ...]
) -> dict[str, dict[str, object]]:
    """The filters, by field.

    Raises:
        ConfigurationError: an invalid parameter, or a field with two filters: one would be lost.
    """
    given: list[tuple[str, dict[str, object]]] = [(path, {"clear": True}) for path in clear]
    given += [(path, {"round": {"step": step}}) for path, step in map(_rounding, rounds)]
    given += [
        (path, {"clamp": {"low": low, "high": high}}) for path, low, high in map(_clamping, clamps)
    ]
    for path, times in Counter(path for path, _ in given).items():
        if times > 1:
            raise ConfigurationError(
                f"{path}: {times} filters for one field", "one of --clear, --round and --clamp"
            )
    return dict(given)


def restrictions(
    type_name: str | None,
    filters: dict[str, dict[str, object]],
    when: tuple[str, ...],
    rate: float | None,
    preset_name: str | None,
) -> list[Restriction]:
    """Build the restrictions and compile them for the message type: mistakes show here."""
    if not filters and not when and rate is None and preset_name is None:
        return []
    if type_name is None:
        raise ConfigurationError(
            "restrictions need the message type they are for", "add --type PKG/TYPE"
        )
    shape = parse(type_name, part_type(type_name).definition)
    try:
        made = [preset(preset_name).restriction(shape)] if preset_name is not None else []
        if filters or when or rate is not None:
            made.append(Restriction(type_name, when, filter_rules(filters), rate))
        for restriction in made:
            compile_filter(shape, restriction.filters)
            for text in restriction.conditions:
                compile_condition(shape, text)
    except (ConditionRefused, FilterRefused) as error:
        error.hint = error.hint or _EXAMPLES
        raise
    return made


def permissions(
    wanted: Mapping[Right, tuple[str, ...]], *, graph: bool, restricted: list[Restriction]
) -> tuple[Permission, ...]:
    """The permissions of the grant.

    Raises:
        ConfigurationError: no right is given, or no right that can be restricted.
    """
    made: list[Permission] = []
    for right, patterns in wanted.items():
        inside = restricted if right in _RESTRICTED and restricted else [None]
        # all restrictions that cover a name hold together
        made += [Permission(pattern, right, item) for pattern in patterns for item in inside]
    if graph:
        made.append(Permission("/**", Right.GRAPH))
    if not made:
        raise ConfigurationError(
            "a grant that allows nothing", "add --publish, --subscribe, --call or another right"
        )
    if restricted and not any(item.restriction for item in made):
        raise ConfigurationError(
            "conditions and filters restrict what a subscriber sees and what a caller may ask",
            "add --subscribe or --call",
        )
    return tuple(made)


def _clamping(text: str) -> tuple[str, float, float]:
    path, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    try:
        return path, _number(low), _number(high)
    except ValueError:
        raise ConfigurationError(
            f"--clamp {text} has no range", "for example --clamp ranges=0.5:10"
        ) from None


def _number(text: str) -> float:
    """An integer where it is written so: integer fields accept no float."""
    try:
        return int(text)
    except ValueError:
        return float(text)


def _rounding(text: str) -> tuple[str, float]:
    path, _, step = text.partition("=")
    try:
        return path, float(step)
    except ValueError:
        raise ConfigurationError(
            f"--round {text} has no step", "for example --round pose.position=2.0"
        ) from None
