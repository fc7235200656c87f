"""`basics` of a policy: one more rule, which gives every node what every ROS program needs.

`basics: true` is the table of `grants.basics` and no more; `basics: [tf]` also lets every node
subscribe to the transforms. The rule is a rule like any other: a denial overrides it, and `explain`
names it. It lasts as long as the longest rule of the policy: else it would shorten the grants of
wide rules, such as `param-get: /**`, that give its names too.
"""

from collections.abc import Iterable
from typing import Final

from grants.basics import BASICS, TRANSFORMS
from grants.model import Right
from grants.policy import readers
from grants.policy.mistakes import Mistakes
from grants.policy.model import EVERYONE, Clause, Defaults, Effect, PolicyRule, SubjectPattern
from grants.policy.source import Part, YamlScalar

ID: Final = "basics"
EXTRAS: Final = {"tf": (Right.SUBSCRIBE, TRANSFORMS)}
_WHY: Final = "what every ROS program needs"
_HINT: Final = "write basics: true, or basics: [tf] for the transforms too"


def read_basics(part: Part | None, mistakes: Mistakes) -> tuple[str, ...] | None:
    """What `basics` adds to the table: `tf`, or nothing; None without basics."""
    if part is None or (isinstance(part, YamlScalar) and part.value is False):
        return None
    if isinstance(part, YamlScalar) and part.value is True:
        return ()
    items = readers.items(part)
    if not items or isinstance(part, YamlScalar):
        mistakes.add(part, "basics is true, false or a list", _HINT)
        return None
    found = (readers.choice(item, "part of basics", EXTRAS, mistakes) for item in items)
    return tuple(dict.fromkeys(name for name in found if name is not None))


def basics_rule(
    extras: Iterable[str], line: int, defaults: Defaults, rules: Iterable[PolicyRule]
) -> PolicyRule:
    """The rule of `basics` in this line, beside the other rules of the policy."""
    clauses = [Clause(right, name) for right, names in BASICS.items() for name in names]
    for extra in extras:
        right, names = EXTRAS[extra]
        clauses += [Clause(right, name) for name in names]
    lasting = [each for each in rules if each.effect is not Effect.DENY]
    return PolicyRule(
        ID,
        Effect.ALLOW,
        (SubjectPattern(EVERYONE, "/**"),),
        tuple(clauses),
        _WHY,
        lifetime=max((each.lifetime for each in lasting), default=defaults.lifetime),
        renew_until=max((each.renew_until for each in lasting), default=defaults.renew_until),
        has_lifetime=True,
        line=line,
    )


def is_basics(rule: PolicyRule) -> bool:
    """Whether the rule is that of `basics`, and gives nothing that is not of the table."""
    table = {
        (right, name) for right, names in (*BASICS.items(), *EXTRAS.values()) for name in names
    }
    return rule.id == ID and {(each.right, each.pattern) for each in rule.clauses} <= table
