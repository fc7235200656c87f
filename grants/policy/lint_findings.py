"""What lint can say: one entry in `ADVICE` for each code, and a finding in a policy.

A code is an interface: scripts compare it, documents explain it (docs/spec/policy.md has the same
table), so a code keeps its meaning and is never given to anything else. A finding carries the
change of the rule that it suggests where there is one, so that tests apply every suggestion:
what lint advises, `rossec policy check` accepts.
"""

from dataclasses import dataclass, field
from typing import Final

from grants.model import FilterRule


@dataclass(frozen=True)
class Advice:
    """One kind of advice: what it says, and what to do."""

    says: str
    do: str


ADVICE: Final[dict[str, Advice]] = {
    # rules
    "no-reason": Advice("a rule without `why`", "say why: people are shown it"),
    "no-lifetime": Advice(
        "neither the rule nor `defaults` has a `lifetime`", "say how long a grant holds"
    ),
    "long-lifetime": Advice("rights for more than a year", "shorten it; renewal is automatic"),
    "wide-right": Advice(
        "a right to act on everything below a name, not the node's own",
        "name the topics and services one by one",
    ),
    "speaks-for-others": Advice(
        "several nodes may publish, provide or set names of each other",
        'write `"{node}/pose"`, the own names of each'
    ),
    "keep-when-stale": Advice(
        "connections that outlive withheld revocation data",
        "use `on_stale: keep` only for what must not stop",
    ),
    "never-decides": Advice(
        "a right that another rule always denies, or allows before it is asked for", "remove it"
    ),
    "unused-identity": Advice("an identity that no rule names", "remove it, or use it"),
    "unused-group": Advice("a group that no rule names", "remove it, or use it"),
    "unused-filter": Advice("a filter that no rule uses", "remove it, or use it"),
    "unused-type": Advice("the type of a topic that no rule names", "remove it, or correct it"),
    # conditions
    "condition-tells": Advice(
        "a condition reads a field that the same receiver may not see: that a message comes"
        " tells its value",
        "remove the condition, or leave the field as it is",
    ),
    # fields of the same message
    "position-open": Advice("a coordinate is filtered, another is not", "filter it as well"),
    "movement-open": Advice(
        "the position is filtered, the velocity is not: the path follows by integration",
        "clear the velocity",
    ),
    "heading-open": Advice(
        "the position is filtered, the orientation is not: turns show the direction of movement",
        "clear the orientation",
    ),
    "covariance-open": Advice(
        "the position is filtered, its covariance is not: it changes with the hidden value",
        "clear the covariance",
    ),
    "time-open": Advice(
        "the position is filtered, stamps or counts are not: they tell when a cell changed",
        "round the stamp, clear `seq`",
    ),
    "name-open": Advice(
        "one name of a thing is hidden, another is not: a name that occurs once links the rest",
        "clear it",
    ),
    # parameters
    "no-hysteresis": Advice(
        "rounded without hysteresis: changes at a border show the exact position",
        "add half of the step",
    ),
    "no-rate": Advice(
        "coarse, but every message is sent: they average to the exact value, and tell when it"
        " changes",
        "limit the rate",
    ),
    "rounded-array": Advice(
        "values of an array are rounded: together they give the exact ones", "clear the array"
    ),
    "step-does-nothing": Advice("a step smaller than what the sensor errs", "use a larger step"),
    "hysteresis-does-nothing": Advice(
        "a hysteresis below a tenth of the step", "use half of the step"
    ),
    "rate-does-nothing": Advice(
        "a rate as high as the topic's own: a robot is seen every half metre", "lower the rate"
    ),
    "pixels-too-small": Advice(
        "squares in which a face is recognised", "at most 16 across, of at least 32 pixels"
    ),
    "pixels-fixed": Advice(
        "squares of so many pixels, whatever the size of the picture: a large one shows a face",
        "say how many there are `across`, at most",
    ),
    "region-open": Advice(
        "only a region of a picture is in squares: what is beside it is as it is",
        "treat the whole picture",
    ),
    "no-grey-levels": Advice(
        "squares that show the colour of one pixel: ten moving pictures show a face",
        "add 8 levels of grey",
    ),
    "rooms-too-small": Advice(
        "rooms below 1 m² or 0.8 m: a fine grid", "give real rooms, or round to 4 m"
    ),
    "clamp-keeps-values": Advice(
        "a clamped position is exact between the limits", "round it, or clear it"
    ),
    # other topics and receivers
    "exact-relative": Advice(
        "the receiver sees another topic exactly that shows the same", "filter that as well"
    ),
    "presence-open": Advice(
        "one topic is seen in slots, another of the same place as its messages come: they tell the"
        " moment",
        "put it in slots as well",
    ),
    "service-tells": Advice(
        "the position is filtered, and a service answers with it, the way or the map",
        "take the right to call it out",
    ),
    "graph-tells": Advice(
        "the right to the graph beside something hidden: it tells who publishes, when, and how many"
        " messages",
        "take it out, or limit it to other names",
    ),
    "wheels-open": Advice(
        "the position is filtered, and joints are in steps: those of wheels give the path",
        "clear the joints",
    ),
    "unknown-type": Advice(
        "beside something filtered, the receiver sees a topic of which lint knows nothing",
        "add its type to `types`, say what it tells in `vocabulary`, or withhold it",
    ),
    "two-versions": Advice(
        "one receiver or owner sees two grids that do not nest: together they are finer",
        "use the same step, or a multiple",
    ),
    "shared-pseudonym": Advice(
        "two receivers, or all of a pattern, get the same pseudonyms: together they know more",
        "add `per: receiver`",
    ),
    "second-receiver": Advice(
        "another node of the same owner sees exactly what this one sees coarsely",
        "filter it for both",
    ),
}  # fmt: skip


FORM: Final = frozenset({
    "no-reason", "no-lifetime", "long-lifetime", "never-decides",
    "unused-identity", "unused-group", "unused-filter", "unused-type",
})  # fmt: skip
"""Codes of what gives nothing away; every other code is a leak, or a right that is too wide."""


@dataclass(frozen=True)
class Suggestion:
    """A change of rule `rule`: a treatment of a field, a rate, a condition less, another pattern.

    Args:
        topic: the topic or pattern of the rule whose filter gets `treatment`, in place of any
            treatment of the same field.
        rate: messages a second.
        without: the condition to remove.
        instead: the pattern to write in place of `topic`.
    """

    rule: str
    topic: str = ""
    treatment: FilterRule | None = None
    rate: float | None = None
    without: str = ""
    instead: str = ""


@dataclass(frozen=True, order=True)
class Finding:
    """One piece of advice on one line of a policy; `code` is a key of `ADVICE`."""

    line: int
    code: str
    message: str
    hint: str
    suggestions: tuple[Suggestion, ...] = field(default=(), compare=False)

    @property
    def is_leak(self) -> bool:
        """Whether it gives something away or allows too much, beyond the form of a rule."""
        return self.code not in FORM

    def as_json(self) -> dict[str, object]:
        """For programs."""
        names = ("line", "code", "message", "hint")
        return {name: getattr(self, name) for name in names}
