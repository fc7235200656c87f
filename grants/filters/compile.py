"""Field filters: from rules and a layout to a function on serialized messages.

The rules are matched against the layout here; the operators are in `grants.filters.operators`, the
rewriting of bytes in `grants.filters.message_rewriter`. A message is filtered without being
deserialized, so no message classes are needed, and previously unknown types can be filtered.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Final, TypeAlias

from grants.common_state import CommonState, FieldKey, HysteresisState
from grants.errors import FilterRefused
from grants.filters.codegen import LAYOUT_ERRORS, Buffer, layout_mismatch
from grants.filters.hashing import Keys
from grants.filters.layout import Array, Layout, Struct, Type
from grants.filters.message_rewriter import generate
from grants.filters.operators import AFTER_OTHERS, treatment_for
from grants.filters.treatments import (
    DESCEND,
    ArrayTreatment,
    FieldTreatment,
    HysteresisBinding,
    Keep,
    Node,
    Numbers,
    SiblingTreatment,
    StructTreatment,
    TreatmentForType,
    has_hysteresis,
)
from grants.model import FilterRule

_SMALL: Final = 2048  # bytes; below it a copy is cheaper than a view


@dataclass(frozen=True)
class Filter:
    """A compiled filter for messages of one type."""

    type_name: str
    _rewrite: Callable[[Buffer], list[Buffer]]

    def __call__(self, message: Buffer) -> list[Buffer]:
        """Return the filtered message in pieces; kept parts of a large one are views into it.

        Raises:
            MessageRefused: the message does not have the layout of the type.
        """
        try:
            return self._rewrite(message if len(message) < _SMALL else memoryview(message))
        except LAYOUT_ERRORS:
            raise layout_mismatch(self.type_name) from None


def compile_filter(
    layout: Layout,
    rules: Iterable[FilterRule],
    keys: Keys | None = None,
    states: Callable[[FieldKey], HysteresisState] | None = None,
) -> Filter:
    """Compile `rules` (see `model.filter_rules`) for messages of `layout`.

    `keys` by name are for `hash`; without them the rules are only checked, and a message to be
    hashed is refused. `states` finds the state of a field with hysteresis; without it, it is new.

    Raises:
        FilterRefused: an unknown field or operator, a treatment that does not fit the field's
            type, a key that is missing, or two rules for one field.
    """
    given = tuple(rules)
    last = [rule for rule in given if rule.operator in AFTER_OTHERS]
    find = states or CommonState().hysteresis
    first = _rewriter(layout, [rule for rule in given if rule not in last], keys, find)
    if not last:
        return Filter(layout.type_name, first)
    then = _rewriter(layout, last, keys, find)
    return Filter(layout.type_name, lambda message: then(b"".join(first(message))))


def _rewriter(
    layout: Layout,
    rules: Iterable[FilterRule],
    keys: Keys | None,
    states: Callable[[FieldKey], HysteresisState],
) -> Callable[[Buffer], list[Buffer]]:
    branch = _Branch({})
    for rule in rules:
        _insert(branch, rule, treatment_for(rule, keys))
    return generate(_bind_hysteresis(_resolve(layout.root, branch, ""), states, ()))


@dataclass(frozen=True)
class _Branch:
    """Rules by field; a field written `name[*]` has its own entry."""

    children: dict[str, "_Branch | TreatmentForType"]


def _insert(branch: _Branch, rule: FilterRule, treat: TreatmentForType) -> None:
    *above, last = rule.path.split(".")
    for step in above:
        below = branch.children.setdefault(step, _Branch({}))
        if not isinstance(below, _Branch):
            raise _overlap(rule.path)
        branch = below
    if last in branch.children or last.endswith("[*]"):
        raise _overlap(rule.path) if last in branch.children else _no_element(rule.path)
    branch.children[last] = treat


def _overlap(path: str) -> FilterRefused:
    return FilterRefused(
        f"{path} is inside a field that has a filter, or contains one",
        "the order would matter: keep one of them",
    )


def _no_element(path: str) -> FilterRefused:
    return FilterRefused(
        f"{path}: [*] must be followed by a field", f"{path[:-3]} filters all of the elements"
    )


def _resolve(kind: Struct, branch: _Branch, path: str) -> Node:
    """The treatment of a message, field by field."""
    fields = dict(kind.fields)
    for step in branch.children:
        if step.removesuffix("[*]") not in fields:
            raise FilterRefused(f"{path}{step}: {kind.explain_missing(step.removesuffix('[*]'))}")
        if step.endswith("[*]") and step[:-3] in branch.children:
            raise _overlap(path + step)
    parts = [_field(name, member, branch, path) for name, member in kind.fields]
    for (name, _), part in zip(kind.fields, parts, strict=True):
        if isinstance(part, FieldTreatment) and isinstance(part.treatment, SiblingTreatment):
            _check_siblings(kind, name, part.treatment, path)
    return _parts(kind, parts)


def _check_siblings(kind: Struct, name: str, treatment: SiblingTreatment, path: str) -> None:
    """The field needs others of its message: they must precede it and have the right types."""
    before = [(field, member.name) for field, member in kind.fields]
    before = before[: before.index((name, dict(kind.fields)[name].name))]
    if kind.name != treatment.message or not set(treatment.siblings) <= set(before):
        raise FilterRefused(
            f"{path}{name} of a {kind.name}: the operator needs the data of a {treatment.message}"
        )


def _bind_hysteresis(
    node: Node, states: Callable[[FieldKey], HysteresisState], path: FieldKey
) -> Node:
    """Bind every field with hysteresis to its state; a field of another type has another."""
    match node:
        case FieldTreatment(
            kind, Numbers(hysteresis=HysteresisBinding(parameters, bind)) as numbers
        ):
            state = states((*path, kind.name, *parameters))
            return FieldTreatment(kind, replace(numbers, scalar=bind(state)))
        case StructTreatment(kind, parts):
            fields = zip(kind.fields, parts, strict=True)
            return StructTreatment(
                kind,
                tuple(_bind_hysteresis(part, states, (*path, name)) for (name, _), part in fields),
            )
        case _:
            return node


def _field(name: str, kind: Type, branch: _Branch, path: str) -> Node:
    inside = branch.children.get(f"{name}[*]")
    if isinstance(inside, _Branch):
        if not isinstance(kind, Array) or not isinstance(kind.element, Struct):
            raise FilterRefused(f"{path}{name} is a {kind.name}, not an array of messages")
        return _each(kind, _resolve(kind.element, inside, f"{path}{name}[*]."))
    below = branch.children.get(name)
    if below is None:
        return Keep(kind)
    if not isinstance(below, _Branch):
        return _apply(below, kind, path + name, {})
    if not isinstance(kind, Struct):
        hint = f"write {path}{name}[*] for its elements" if isinstance(kind, Array) else ""
        raise FilterRefused(f"{path}{name} is a {kind.name} and has no fields", hint)
    return _resolve(kind, below, f"{path}{name}.")


_Memo: TypeAlias = dict[Type, Node]


def _apply(treat: TreatmentForType, kind: Type, path: str, memo: _Memo) -> Node:
    """One treatment for everything in `kind`; equal types share it, so arrays can merge them."""
    if kind not in memo:
        try:
            found = treat(kind)
        except FilterRefused as error:
            raise FilterRefused(f"{path}: {error}", error.hint) from None
        if found == DESCEND:
            memo[kind] = _descend(treat, kind, path, memo)
        else:
            whole = found.kind if isinstance(found, Numbers) else None
            memo[kind] = FieldTreatment(whole or kind, found)
    return memo[kind]


def _descend(treat: TreatmentForType, kind: Type, path: str, memo: _Memo) -> Node:
    if isinstance(kind, Array):
        return _each(kind, _apply(treat, kind.element, path, memo))
    if isinstance(kind, Struct):
        parts = [_apply(treat, member, f"{path}.{name}", memo) for name, member in kind.fields]
        return _parts(kind, parts)
    raise FilterRefused(f"{path}: no treatment for {kind.name}")


def _parts(kind: Struct, parts: list[Node]) -> Node:
    kept = all(isinstance(part, Keep) for part in parts)
    return Keep(kind) if kept else StructTreatment(kind, tuple(parts))


def _each(kind: Array, element: Node) -> Node:
    if has_hysteresis(element):
        raise FilterRefused(
            f"hysteresis cannot be used on {kind.name}",
            "array elements have no identity between messages",
        )
    if isinstance(element, Keep) or kind.size == 0 or kind.element.size == 0:
        return Keep(kind)  # elements without bytes have nothing to treat
    return ArrayTreatment(kind, element)
