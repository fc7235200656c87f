"""Decisions a second under a policy, by the number of its rules for exact names."""

import time

from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.model import Clause, Defaults, Effect, Policy, PolicyRule, Subject, SubjectPattern

SIZES = (10, 1_000, 10_000)
_QUESTIONS = 10  # the same number for every size: caches of the processor are not the subject


def policy(rules: int) -> Policy:
    """One rule for each of so many nodes and topics, and a denial for every node."""
    made = [
        PolicyRule(
            f"r{n}",
            Effect.ALLOW,
            (SubjectPattern("w", f"/node{n}"),),
            (Clause(Right.SUBSCRIBE, f"/robot{n}/pose"),),
        )
        for n in range(rules)
    ]
    deny = PolicyRule(
        "d", Effect.DENY, (SubjectPattern("*", "/**"),), (Clause(Right.SUBSCRIBE, "/camera/**"),)
    )
    return Policy("bench", Defaults(), {}, {}, (*made, deny))


def decisions_per_s(rules: int, seconds: float = 0.5) -> float:
    """Decisions a second (the best of ten batches) under a policy of `rules` rules."""
    decider = Decider(policy(rules))
    asked = [
        (Subject(f"/node{n}", bytes(32)), f"/robot{n}/pose")
        for n in range(0, rules, max(1, rules // _QUESTIONS))
    ]
    best = 0.0
    for _ in range(10):
        count, start = 0, time.perf_counter()
        while (spent := time.perf_counter() - start) < seconds / 10:
            for subject, name in asked:
                decider.decide(subject, Right.SUBSCRIBE, name)
            count += len(asked)
        best = max(best, count / spent)
    return best


def measure(seconds: float) -> dict[str, object]:
    """Decisions a second by the number of rules, in about `seconds`."""
    each = seconds / len(SIZES)
    return {"decisions_per_s": {str(size): round(decisions_per_s(size, each)) for size in SIZES}}
