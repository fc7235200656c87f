"""A result as text, what the thesis says beside each figure. Pure."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from bench.thesis.claims import EQUIVALENT, LARGEST, LATENCY, MEASURED, MEMORY

_MISSING: Final = "not measured"


def text(result: Mapping[str, Any]) -> str:
    """All of it, as lines."""
    parts = (_memory, _largest, _latency, _copies, _others, _statements)
    return "\n".join(line for part in parts for line in part(result))


def size(count: int) -> str:
    """Bytes in the unit that the thesis would take."""
    for unit, name in ((1_000_000, "MB"), (1000, "kB")):
        if count >= unit:
            return f"{count / unit:g} {name}"
    return f"{count} B"


def _memory(result: Mapping[str, Any]) -> Iterator[str]:
    if (found := result.get("memory_mb")) is None:
        return
    yield "5.1 memory, MB (Pss; RAM in the thesis), and kB for each node"
    said = {
        ours: f"{MEMORY[theirs][0]} ({theirs}), {MEMORY[theirs][1]} kB" for ours, theirs in MEASURED.items()
    }
    for name in (each for each in found if not each.endswith("_a_node")):
        node = found.get(f"{name}_kb_a_node")
        own = f"{found[name]:>8}" + (f", {node} kB" if node is not None else "")
        yield f"  {name:<14}{own:<24}thesis: {said.get(name, '-')}"


def _largest(result: Mapping[str, Any]) -> Iterator[str]:
    found: Mapping[str, int] = result.get("largest_at_1hz", {})
    if not found:
        return
    yield "5.2 the largest message at 1 Hz"
    for name in dict.fromkeys((*LARGEST, *found)):
        own = size(found[name]) if name in found else _MISSING
        yield f"  {name:<14}{own:<24}thesis: {size(LARGEST[EQUIVALENT.get(name, name)])}"


def _latency(result: Mapping[str, Any]) -> Iterator[str]:
    for name, rows in result.get("latency_ms", {}).items():
        yield f"{name}, ms: mean (span of 96 %) [thesis: {LATENCY[EQUIVALENT.get(name, name)]}]"
        for row in rows:
            over = "" if row["holds"] else f"  does not hold: {row['arrived']:.0%} arrived"
            span = f"({row['low']:.1f} to {row['high']:.1f})"
            yield f"  {size(row['size']):>8} {row['rate']:>5g} Hz {row['mean']:>9.1f} {span}{over}"


def _copies(result: Mapping[str, Any]) -> Iterator[str]:
    for name, rows in result.get("copies_on_link", {}).items():
        if rows:
            told = ", ".join(f"{size(int(count))}: {each}" for count, each in rows.items())
            yield f"copies on the link, {name}: {told}"


def _others(result: Mapping[str, Any]) -> Iterator[str]:
    if ratios := result.get("sealed_vs_plain"):
        told = ", ".join(f"{size(int(count))}: {each}" for count, each in ratios.items())
        yield f"latency sealed / plain: {told}"
    for name, value in result.get("failures", {}).items():
        yield f"{name:<24}{value}"
    for count, row in result.get("mesh", {}).items():
        told = ", ".join(f"{name} {value:g}" for name, value in row.items())
        yield f"mesh of {count}: {told}"


def _statements(result: Mapping[str, Any]) -> Iterator[str]:
    for way, rows in result.get("statements", {}).items():
        yield f"5.2.5, {way}"
        for row in rows.values():
            word = {True: "holds", False: "DOES NOT HOLD", None: _MISSING}[row["holds"]]
            ratio = "" if row["ratio"] is None else f" {row['ratio']} {row['bound']}"
            yield f"  {row['says']}: {word}{ratio}"
