"""What lint suggests is tried first; and it is written as a policy writes it."""

from contextlib import suppress
from functools import cache
from typing import Any

import hypothesis.strategies as st
import pytest
from hypothesis import given, settings

from grants.errors import GrantError, PolicyRefused
from grants.filters.compile import compile_filter
from grants.model import FilterRule
from grants.policy.lint_findings import closing, coarsening, fits, limiting, replacing, written
from grants.policy.lint_views import aspects
from grants.policy.privacy import leaf_paths
from grants.vocabulary.contents import describe
from tests.grants.policy.lint_cases import TYPES, applied, findings, layout_of, text_of
from tests.grants.policy.lint_leaks import COARSE, also, filtered
from tests.grants.policy.policies import policy
from tests.grants.policy.test_lint_views import view


@pytest.mark.parametrize(
    ("rule", "text"),
    [
        (FilterRule("header.seq", "clear"), "header.seq: {clear: true}"),
        (FilterRule("a", "round", (("step", 2),)), "a: {round: 2}"),
        (FilterRule("a", "round", (("hysteresis", 1), ("step", 2))), "a: {round: {step: 2, hysteresis: 1}}"),
        (FilterRule("a[*].b", "hash", (("key", "k"),)), '"a[*].b": {hash: k}'),
        (FilterRule("a", "rooms", (("hall", "0 0, 1 1"),)), 'a: {rooms: {hall: "0 0, 1 1"}}'),
    ],
)
def test_treatments_as_a_policy_writes_them(rule: FilterRule, text: str) -> None:
    assert written(rule) == text


def test_the_widest_message_that_holds_nothing_else() -> None:
    seen = view(filtered("/odom", "pose: {clear: true}"), topic="/odom")
    open_fields = [path for path in leaf_paths(layout_of("nav_msgs/Odometry")) if "twist" in path]
    path, text, [change] = closing(seen, open_fields)
    assert (path, text) == ("twist", "twist: {clear: true}")
    assert change.treatment == FilterRule("twist", "clear")
    path, text, _ = closing(seen, ["twist.twist.linear.x", "twist.twist.linear.y"])
    assert text == "twist.twist.linear.x: {clear: true}, twist.twist.linear.y: {clear: true}"


def test_a_treatment_that_does_not_fit_is_not_suggested() -> None:
    seen = view(filtered("/odom", "twist: {clear: true}"), topic="/odom")
    assert not fits(seen, [FilterRule("twist.covariance", "clear")])
    _, text, changes = closing(seen, ["twist.covariance"])
    assert (text, changes) == ("a treatment of it, in a filter that does not overlap", ())
    [old] = seen.filters
    wrong = FilterRule("twist.covariance", "clear")
    assert replacing(seen, old, wrong)[0] == "twist: {clear: true}"
    assert replacing(seen, wrong, wrong) == ("another treatment", ())


def test_an_array_is_cleared_where_hysteresis_is_refused() -> None:
    seen = view(filtered("/scan", "ranges: {round: 1}"), topic="/scan")
    hysteresis = FilterRule("ranges", "round", (("hysteresis", 0.5), ("step", 1)))
    assert replacing(seen, seen.filters[0], hysteresis)[0] == "ranges: {clear: true}"


def test_a_topic_below_a_pattern_is_to_be_named() -> None:
    seen = view(COARSE, also("'/**'"), topic="/tf")
    assert coarsening(seen) == ("name the topics it needs instead of /**", ())
    seen = view(also("/tf"), topic="/tf")
    assert coarsening(seen) == ("withhold /tf, or add its type to types and filter it", ())


def test_a_rate() -> None:
    text, [change] = limiting(view(COARSE), 2)
    assert (text, change.rule, change.rate) == ("add limit: {rate: 2}", "coarse", 2)


TREATMENTS: tuple[tuple[str, tuple[tuple[str, Any], ...]], ...] = (
    ("clear", ()),
    ("drop", ()),
    ("zero", ()),
    ("round", (("step", 0.001),)),
    ("round", (("step", 3),)),
    ("round", (("hysteresis", 0.01), ("step", 3))),
    ("clamp", (("high", 9), ("low", 0))),
    ("truncate", (("length", 0),)),
    ("truncate", (("length", 2),)),
    ("hash", (("key", "k"),)),
    ("sort", ()),
    ("pixelate", (("block", 4),)),
    ("pixelate", (("block", 32),)),
    ("rooms", (("hall", "0 0, 1 1"),)),
)


@cache
def possible(topic: str) -> list[FilterRule]:
    """Every treatment that the type accepts of a field that shows something, or what it is in."""
    layout, found = layout_of(TYPES[topic]), []
    steps = [path.split(".") for path in aspects(describe(layout)) if not path.startswith("header")]
    paths = {".".join(path[:depth]) for path in steps for depth in range(1, len(path) + 1)}
    for path in sorted(path.removesuffix("[*]") for path in paths):
        for treatment in TREATMENTS:
            with suppress(GrantError):
                compile_filter(layout, [FilterRule(path, *treatment)])
                found.append(FilterRule(path, *treatment))
    return found


def _unquoted(rule: FilterRule) -> str:
    """As written, but with a path that `text_of` puts into quotes."""
    return written(rule).replace(f'"{rule.path}"', rule.path)


@st.composite
def filters(draw: st.DrawFn, topic: str) -> str:
    """Some filters of a topic."""
    rules = [draw(st.sampled_from(possible(topic))) for _ in range(draw(st.integers(1, 2)))]
    return ", ".join({rule.path: _unquoted(rule) for rule in rules}.values())


@st.composite
def rules(draw: st.DrawFn) -> list[str]:
    """Up to three rules of two nodes, which filter some topics and leave others open."""
    found = []
    for number in range(draw(st.integers(1, 3))):
        topic = draw(st.sampled_from([topic for topic in TYPES if possible(topic)]))
        fields = draw(st.one_of(st.just(""), filters(topic)))
        rate = draw(st.sampled_from(("", ", limit: {rate: 10}", ", limit: {rate: 0.03}")))
        filtering = f", filter: {{{fields}}}" if fields else ""
        who = draw(st.sampled_from(("/x", "/x/y", "'*'")))
        what = f"id: r{number}, who: {who}, allow: {{subscribe: [{topic}]}}"
        found.append(what + filtering + rate)
    return found


@given(rules())
@settings(max_examples=60, deadline=None)
def test_whatever_is_suggested_is_accepted(lines: list[str]) -> None:
    """What `check` accepts, it accepts with each change, and then the advice is gone."""
    text = text_of(*lines)
    try:
        policy(text)
    except (PolicyRefused, GrantError):
        return
    for finding in findings(text):
        if finding.suggestions:
            changed = applied(text, finding.suggestions)
            policy(changed)
            left = {(each.code, each.message) for each in findings(changed)}
            assert (finding.code, finding.message) not in left
