"""Named restrictions for common needs: what they hide, and what they still reveal.

Rounding a position alone hides little: changes at a cell's border, an exact velocity, stamps and
sequence numbers reveal the rest. A preset treats the field with its related fields. Every text here
is shown to the operator; `docs/spec/grant.md` lists the attacks.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from grants.errors import FilterRefused
from grants.filters.layout import Layout
from grants.model import Restriction, filter_rules

_Rules: TypeAlias = dict[str, dict[str, object]]

_CLEAR: Final[dict[str, object]] = {"clear": True}
_POSITION: Final[dict[str, object]] = {"round": {"step": 2.0, "hysteresis": 0.5}}


@dataclass(frozen=True)
class Preset:
    """A restriction by name.

    Args:
        name: as users write it.
        hides: what the receiver no longer learns.
        reveals: what an attacker who keeps all messages still learns.
        rate: messages a second.
    """

    name: str
    hides: str
    reveals: str
    rate: float
    _rules: Callable[[Layout], _Rules]

    def restriction(self, layout: Layout) -> Restriction:
        """The preset for messages of `layout`.

        Raises:
            FilterRefused: the preset does not support this type.
        """
        return Restriction(
            type=layout.type_name, filters=filter_rules(self._rules(layout)), rate=self.rate
        )


def _header(step: float) -> _Rules:
    return {
        "header.seq": _CLEAR,
        "header.stamp": {"round": {"step": step}},
    }


def _for(types: Mapping[str, _Rules]) -> Callable[[Layout], _Rules]:
    def rules(layout: Layout) -> _Rules:
        if layout.type_name not in types:
            raise FilterRefused(
                f"the preset does not support {layout.type_name}",
                f"it supports {', '.join(types)}",
            )
        return types[layout.type_name]

    return rules


def _everything(layout: Layout) -> _Rules:
    """All fields cleared; only arrays of fixed length keep their length."""
    return {name: _CLEAR for name, _ in layout.root.fields}


_COARSE: Final[Mapping[str, _Rules]] = {
    "geometry_msgs/PoseStamped": _header(10)
    | {"pose.position": _POSITION, "pose.orientation": _CLEAR},
    "geometry_msgs/PoseWithCovarianceStamped": _header(10)
    | {
        "pose.pose.position": _POSITION,
        "pose.pose.orientation": _CLEAR,
        "pose.covariance": _CLEAR,
    },
    "geometry_msgs/PointStamped": _header(10) | {"point": _POSITION},
    "nav_msgs/Odometry": _header(10)
    | {
        "pose.pose.position": _POSITION,
        "pose.pose.orientation": _CLEAR,
        "pose.covariance": _CLEAR,
        "twist": _CLEAR,
    },
}
_DIAGNOSTICS: Final[Mapping[str, _Rules]] = {
    "diagnostic_msgs/DiagnosticArray": _header(60)
    | {
        "status[*].message": _CLEAR,
        "status[*].hardware_id": {"hash": {"key": "diagnostics", "length": 12}},
        "status[*].values": {"drop": True},
    }
}
_CAMERA: Final[Mapping[str, _Rules]] = {
    "sensor_msgs/Image": _header(1) | {"data": {"pixelate": {"block": 32}}}
}

PRESETS: Final[dict[str, Preset]] = {
    preset.name: preset
    for preset in (
        Preset(
            "coarse-position",
            "the place within cells of 2 m, heading, speed, uncertainty and the exact time",
            "the room, when rooms are larger than a cell; when a cell changes, a point that was"
            " within 1.5 m of its middle and has left it, to within 5 s; the route of cells",
            0.2,
            _for(_COARSE),
        ),
        Preset(
            "presence-only",
            "all content",
            "that the publisher works, and when it stops (to within 10 s)",
            0.1,
            _everything,
        ),
        Preset(
            "anonymous-diagnostics",
            "texts, values and hardware numbers",
            "names and levels of the parts; the same part is recognised by its pseudonym and name",
            0.1,
            _for(_DIAGNOSTICS),
        ),
        Preset(
            "blurred-camera",
            "details smaller than 32 pixels, as long as nothing moves",
            "light, colours, that a person moves and where; many pictures of an object moving"
            " past the squares can be combined to finer detail than one of them shows",
            1.0,
            _for(_CAMERA),
        ),
    )
}


def preset(name: str) -> Preset:
    """The preset `name`.

    Raises:
        FilterRefused: unknown preset.
    """
    if name not in PRESETS:
        raise FilterRefused(f"no preset {name[:40]!r}", f"expected one of {', '.join(PRESETS)}")
    return PRESETS[name]
