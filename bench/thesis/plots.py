"""A result drawn: Figs. 5.5 to 5.8 again, with the thesis's values in them. Needs matplotlib."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from bench.thesis.claims import EQUIVALENT, LARGEST, LATENCY, MEASURED, MEMORY

_SMALLEST: Final = 16  # bytes of the stamp: where a size of 0 is on a logarithmic axis
_SIZE: Final = (6.4, 4.0)  # inches
_GREY: Final = "0.4"  # what the thesis says


def draw(result: Mapping[str, Any], folder: Path) -> None:
    """Draw what is in a result into PNG files of a directory."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in result.get("latency_ms", {}).items():
        latency(name, rows).savefig(folder / f"{name}.png", dpi=100)
    if found := result.get("largest_at_1hz"):
        largest(found).savefig(folder / "largest.png", dpi=100)
    if found := result.get("memory_mb"):
        memory(found).savefig(folder / "memory.png", dpi=100)


def latency(name: str, rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Latency by size, a line for each rate, the span of 96 % shaded, as far as points hold."""
    figure = Figure(_SIZE, layout="constrained")
    axes = figure.subplots()
    held = sorted((row for row in rows if row["holds"]), key=lambda row: row["rate"])
    for rate, group in groupby(held, key=lambda row: row["rate"]):
        points = sorted(group, key=lambda row: row["size"])
        sizes = [max(_SMALLEST, row["size"]) for row in points]
        axes.plot(sizes, [row["mean"] for row in points], marker="o", label=f"{rate:g} Hz")
        axes.fill_between(sizes, [row["low"] for row in points], [row["high"] for row in points], alpha=0.2)
    same = EQUIVALENT.get(name, name)
    axes.axvline(LARGEST[same], label="largest at 1 Hz in the thesis", color=_GREY, linestyle="--")
    axes.set(xscale="log", yscale="log", xlabel="bytes", ylabel="ms")
    axes.set_title(f"{name} (thesis: {LATENCY[same]})", fontsize=9)
    axes.legend(fontsize=8)
    return figure


def largest(found: Mapping[str, int]) -> Figure:
    """The largest message at 1 Hz of each set-up; plain ROS is measured for its latencies alone."""
    names = [name for name in found if not name.startswith("plain")]
    said = [LARGEST[EQUIVALENT.get(name, name)] for name in names]
    figure = _bars(names, [found[name] for name in names], said, "bytes at 1 Hz")
    figure.axes[0].set_yscale("log")
    return figure


def memory(found: Mapping[str, float]) -> Figure:
    """Memory of each program."""
    names = [name for name in found if not name.endswith("_a_node")]
    said = [MEMORY[MEASURED[name]][0] if name in MEASURED else 0 for name in names]
    return _bars(names, [found[name] for name in names], said, "MB")


def _bars(names: Sequence[str], own: Sequence[float], said: Sequence[float], unit: str) -> Figure:
    figure = Figure(_SIZE, layout="constrained")
    axes = figure.subplots()
    axes.bar(names, own, width=0.5, label="here")
    for place, value in [each for each in enumerate(said) if each[1]]:
        axes.hlines(value, place - 0.4, place + 0.4, label="" if place else "thesis", color=_GREY)
    axes.set_ylabel(unit)
    axes.tick_params(axis="x", labelsize=7)
    axes.legend(fontsize=8)
    return figure
