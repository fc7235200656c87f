"""`rossec simulate`: what another policy would change, tried on a recorded bag."""

import bz2
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import click
import lz4.frame
from lz4.frame import LZ4FrameDecompressor
from rosbags.rosbag1 import Reader, ReaderError

from ca.errors import HintedError
from ca.names import check_name
from grants.errors import GrantError
from grants.filters.layout import Layout, parse
from grants.model import Right
from grants.policy.decision import Decider
from grants.policy.learn import empty
from grants.policy.model import Policy, Subject
from grants.policy.privacy import Trial, TrialOutcome
from rossec.authority.policyfile import PolicyFile, parse_policy, place, read_policy
from rossec.cli.policy.explain import changes, subject_of
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.errors import ConfigurationError, MessageError
from rossec.ros.tcpros import MESSAGE_LIMIT
from rossec.terminal import note, printable

# What the reader of bags raises for wrong bytes, few of which it checks first.
_BROKEN = (
    ReaderError,
    OSError,
    EOFError,
    ValueError,
    LookupError,
    struct.error,
    TypeError,
    AttributeError,
    AssertionError,
    RuntimeError,
    ArithmeticError,
    MemoryError,
)
MAX_CHUNK = MESSAGE_LIMIT + (16 << 20)  # bytes, decompressed: one long message and others
MAX_MESSAGES = 100_000  # per bag; the rest is said to be left out


@dataclass
class Tally:
    admitted: int = 0
    withheld: int = 0
    reason: str = ""
    example: list[str] = field(default_factory=list)

    def count(self, kind: str, message: bytes, outcome: TrialOutcome) -> None:
        if outcome.message is None:
            self.withheld += 1
            self.reason = self.reason or outcome.reason
            return
        self.admitted += 1
        if self.admitted == 1 and outcome.message != message:
            self.example = _example(kind, message, outcome.message)


@click.command()
@options.option("--policy new", "the policy to try", type=options.FILE, required=True)
@options.option("--old", "compare with this; by default the one in force, if any", type=options.FILE)
@options.option("--bag", "a bag of ROS 1", type=options.FILE, required=True)
@options.option("--node nodes", "only as this receiver sees it", multiple=True)
@options.as_json
@pass_environment
def simulate(
    environment: Environment, new: Path, old: Path | None, bag: Path, nodes: tuple[str, ...], as_json: bool
) -> None:
    """Show per topic and receiver how many messages of a bag pass, before and after.

    Conditions and rates see each message at the time it was recorded.
    """
    read = PolicyFile.read(new)
    before = PolicyFile.read(old) if old is not None else _in_force(environment)
    if nodes:
        receivers = [subject_of(environment, node) for node in nodes]
    else:
        receivers = receivers_in(before.policy, read.policy)
    with options.working("reading the bag", quiet=as_json):
        found = run(bag, receivers, (before.decider, read.decider))
    lines = (line for (topic, who), tallies in found.items() for line in _lines(topic, who, *tallies))
    document = [
        {"topic": topic, "receiver": who, "old": vars(old), "new": vars(new)}
        for (topic, who), (old, new) in found.items()
    ]
    options.say_result(as_json, document, lines if found else ["the bag holds nothing for these receivers"])


def _in_force(environment: Environment) -> PolicyFile:
    path = place(environment.home, None)
    if path.exists():
        return read_policy(environment.home, None)
    note("no policy is in force here: compared with one that denies everything")
    return PolicyFile(path, empty(), parse_policy(empty(), str(path)))


def run(
    bag: Path, receivers: list[Subject], deciders: tuple[Decider, Decider]
) -> dict[tuple[str, str], tuple[Tally, Tally]]:
    found: dict[tuple[str, str], tuple[Tally, Tally]] = {}
    trials: dict[tuple[str, int, str], tuple[Trial, Trial]] = {}
    for topic, layout, number, now, message in _messages(bag):
        for receiver in receivers:
            key = (topic, number, receiver.name)
            if key not in trials:
                old, new = (decider.decide(receiver, Right.SUBSCRIBE, topic) for decider in deciders)
                trials[key] = Trial(layout, old), Trial(layout, new)
            tallies = found.setdefault((topic, receiver.name), (Tally(), Tally()))
            for trial, tally in zip(trials[key], tallies, strict=True):
                tally.count(layout.type_name, message, trial(message, now))
    return found


def _messages(bag: Path) -> Iterator[tuple[str, Layout, int, int, bytes]]:
    layouts: dict[int, Layout | None] = {}
    try:
        with Reader(bag) as reader:
            # A bag of kilobytes may hold gigabytes (attack `bag-bomb`).
            bounded = {bz2.decompress: bz2.BZ2Decompressor, lz4.frame.decompress: LZ4FrameDecompressor}
            for position, chunk in reader.chunks.items():
                make = bounded.get(chunk.decompressor)
                if make is not None:
                    reader.chunks[position] = chunk._replace(decompressor=partial(_decompress, make))
            for number, (connection, at, data) in enumerate(reader.messages()):
                if number >= MAX_MESSAGES:
                    note(f"only the first {MAX_MESSAGES} messages of {bag} were tried")
                    return
                if connection.id not in layouts:
                    layouts[connection.id] = _layout(connection)
                layout = layouts[connection.id]
                if layout is not None:
                    yield connection.topic, layout, connection.id, at // 10**9, bytes(data)
    except _BROKEN as error:
        what = printable(str(error)) or type(error).__name__
        hint = "see: rosbag record, rosbag reindex, rosbag check"
        raise ConfigurationError(f"{bag} is not a complete ROS 1 bag: {what}", hint) from error


def _decompress(make: Callable[[], Any], data: bytes) -> bytes:
    decompressor = make()
    content: bytes = decompressor.decompress(data, MAX_CHUNK)
    if not decompressor.eof:
        raise ReaderError(f"a chunk that is cut off, or has more than {MAX_CHUNK} bytes")
    return content


def _layout(connection: Any) -> Layout | None:
    name = connection.msgtype.replace("/msg/", "/")
    try:
        check_name(connection.topic)
        layout = parse(name, getattr(connection.msgdef, "data", connection.msgdef))
    except HintedError as error:
        note(f"{connection.topic} ({name}) is left out: {error}")
        return None
    return layout


def receivers_in(*policies: Policy) -> list[Subject]:
    """A node for each way in which rules about subscribing name one."""
    found = {
        who.sample
        for policy in policies
        for rule in policy.rules
        for who in (*rule.who, *rule.exceptions)
        if any(clause.right is Right.SUBSCRIBE for clause in rule.clauses)
    }
    return sorted(found, key=lambda subject: (subject.name, subject.key))


def _example(kind: str, before: bytes, after: bytes) -> list[str]:
    try:
        return changes(kind, before, after)[:8]
    except (MessageError, GrantError):
        return ["a type not known here: changed, but not shown"]


def _lines(topic: str, receiver: str, old: Tally, new: Tally) -> Iterator[str]:
    total = old.admitted + old.withheld
    yield f"{topic} -> {receiver}: {old.admitted} of {total} admitted before, {new.admitted} after"
    for when, tally in (("before", old), ("after", new)):
        if tally.reason:
            yield f"  withheld {when}: {tally.reason}"
    if new.example and new.example != old.example:
        yield "  a message after:"
        yield from (f"    {line}" for line in new.example)
