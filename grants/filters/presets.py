"""Named restrictions for common needs: what they hide, and what they still reveal.

Rounding a position alone hides little: changes at a cell's border, an exact velocity, stamps and
sequence numbers reveal the rest. A preset treats the field with its related fields. Every text here
is shown to the operator; `python -m bench privacy` attacks each preset, `docs/spec/grant.md` lists
the attacks. A grant holds what its preset said when it was signed, so a preset may change.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, TypeAlias

from grants.errors import FilterRefused
from grants.filters.layout import Layout
from grants.model import Restriction, filter_rules

_Rules: TypeAlias = dict[str, dict[str, object]]

_OUTDOORS: Final = "sensor_msgs/NavSatFix"
_CLEAR: Final[dict[str, object]] = {"clear": True}
_DROP: Final[dict[str, object]] = {"drop": True}
# 2 m with 0.5 m every 5 s left an attacker who knows the habits 1.05 m; this leaves 2.6 m.
_POSITION: Final[dict[str, object]] = {"round": {"step": 4.0, "hysteresis": 2.0}}
_DEGREES: Final[dict[str, object]] = {"round": {"step": 0.02, "hysteresis": 0.01}}  # 2.2 km north


@dataclass(frozen=True)
class Preset:
    """A restriction by name.

    Args:
        name: as users write it.
        hides: what the receiver no longer learns.
        reveals: what an attacker who keeps all messages still learns.
        rate: messages a second, if limited.
        slot: seconds of a slot, if messages are limited to one in each.
        outdoors: the same for a NavSatFix, whose cells are as much larger.
    """

    name: str
    hides: str
    reveals: str
    _rules: Callable[[Layout], _Rules]
    rate: float | None = None
    slot: int | None = None
    outdoors: int | None = None

    def restriction(self, layout: Layout) -> Restriction:
        """The preset for messages of `layout`.

        Raises:
            FilterRefused: the preset does not support this type.
        """
        large = layout.type_name == _OUTDOORS and self.outdoors is not None
        return Restriction(
            type=layout.type_name, filters=filter_rules(self._rules(layout)), rate=self.rate,
            slot=self.outdoors if large else self.slot,
        )  # fmt: skip


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


# A scan has no coarse form: walls to a metre are the position to a centimetre.
_COARSE: Final[Mapping[str, _Rules]] = {
    "geometry_msgs/PoseStamped": _header(60)
    | {"pose.position": _POSITION, "pose.orientation": _CLEAR},
    "geometry_msgs/PoseWithCovarianceStamped": _header(60)
    | {
        "pose.pose.position": _POSITION,
        "pose.pose.orientation": _CLEAR,
        "pose.covariance": _CLEAR,
    },
    "geometry_msgs/PointStamped": _header(60) | {"point": _POSITION},
    "nav_msgs/Odometry": _header(60)
    | {
        "pose.pose.position": _POSITION,
        "pose.pose.orientation": _CLEAR,
        "pose.covariance": _CLEAR,
        "twist": _CLEAR,
    },
    "sensor_msgs/NavSatFix": _header(60)
    | {"latitude": _DEGREES, "longitude": _DEGREES}
    | dict.fromkeys(
        ("status", "altitude", "position_covariance", "position_covariance_type"), _CLEAR
    ),
    "sensor_msgs/JointState": _header(60)
    # Of wheels, they are the way that was gone.
    | {"position": _DROP, "velocity": _DROP, "effort": _DROP},
}
_DIAGNOSTICS: Final[Mapping[str, _Rules]] = {
    "diagnostic_msgs/DiagnosticArray": _header(60)
    | {
        "status": {"sort": True},
        "status[*].name": _CLEAR,
        "status[*].message": _CLEAR,
        "status[*].hardware_id": {"hash": {"key": "diagnostics", "length": 12, "per": "receiver"}},
        "status[*].values": _DROP,
    }
}
_CAMERA: Final[Mapping[str, _Rules]] = {
    # Squares of 32 pixels hide a face at 320 x 240, and show everybody's at 1920 x 1080.
    "sensor_msgs/Image": _header(10)
    | {"data": {"pixelate": {"across": 16, "block": 32, "levels": 8}}}
}

PRESETS: Final[dict[str, Preset]] = {
    preset.name: preset
    for preset in (
        Preset(
            "coarse-position",
            "the place within cells of 4 m, of 2 km outdoors, joints, heading, speed, uncertainty"
            " and the exact time",
            "the part of the home, and often the room to somebody who knows the habits; that it"
            " moves, to within a minute; the route of cells; of one that sends seldom, little"
            " arrives",
            _for(_COARSE),
            slot=30,
            outdoors=900,
        ),
        Preset(
            "presence-only",
            "all content, the moment at which something begins or ends, and what happens once",
            "in which minutes the publisher is at work, if it sends more than once in 2 s;"
            " of one that sends less, next to nothing arrives; when it registers, connects and"
            " ends, to the moment",
            _everything,
            slot=60,
        ),
        Preset(
            "anonymous-diagnostics",
            "texts, values, names, hardware numbers, and which part is which for two receivers",
            "how many parts there are and their levels, each part recognised by its pseudonym;"
            " two receivers who compare levels for an hour know which are the same",
            _for(_DIAGNOSTICS),
            rate=0.1,
        ),
        Preset(
            "blurred-camera",
            "colours, and details smaller than a sixteenth of the picture or 32 pixels, such as the"
            " face of somebody who is not close to the camera",
            "light, that something moves and where; whatever is larger than some squares, as a"
            " text; by many pictures of somebody who moves, which of a few known people it is",
            _for(_CAMERA),
            rate=1.0,
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
