"""The evaluation of the thesis (chapter 5) repeated, with encryption on, in network namespaces.

`5.1` memory, `5.2.1` to `5.2.4` latencies and the largest message at 1 Hz, directly and routed, on
links of 100 Mbit/s and 300 kbit/s; `failures` and `mesh` are not in the thesis. Without names all
of them, in less than four minutes; `--sweep` goes through sizes and rates in half an hour, `--full`
through more of them, for hours. What the thesis says stands beside each figure; its statements of
5.2.5 are ratios, which `--check` demands. `docs/evaluation.md` says what the figures mean.
"""

import argparse
import json
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from bench.thesis import failures, latency, memory, meshes, report
from bench.thesis.claims import failed, judged
from bench.thesis.table import setup

EXPERIMENTS: Final = {
    "5.1": (),
    "5.2.1": ("direct_100m", "plain_100m"),
    "5.2.2": ("gateway_100m", "relay_100m"),
    "5.2.3": ("direct_300k",),
    "5.2.4": ("gateway_300k", "relay_300k"),
    "failures": ("relay_100m", "gateway_100m"),
    "mesh": (),
}
SHORT_MESHES: Final = (2, 3, 4)
WHOLE_MESHES: Final = (2, 3, 4, 6, 8, 10)

PARSER: Final = argparse.ArgumentParser(prog="python -m bench thesis", description=__doc__)
PARSER.add_argument("experiments", nargs="*", choices=[[], *EXPERIMENTS], help="default: all")
PARSER.add_argument("--sweep", action="store_true", help="powers of ten of sizes and rates: half an hour")
PARSER.add_argument("--full", action="store_true", help="all sizes, rates and meshes: hours")
PARSER.add_argument("--plot", metavar="DIR", type=Path, help="draw the figures (extra bench)")
PARSER.add_argument("--saved", metavar="FILE", type=Path, help="what --json printed, instead of measuring")
PARSER.add_argument("--check", action="store_true", help="fail unless the statements hold")

text = report.text


def measure(
    _seconds: float,
    experiments: Iterable[str] = (),
    *,
    sweep: bool = False,
    full: bool = False,
    plot: Path | None = None,
    saved: Path | None = None,
    check: bool = False,
) -> dict[str, Any]:
    """Run experiments; how long they take is not a matter of `_seconds`.

    Raises:
        NoNamespaces: this machine permits none.
        SystemExit: matplotlib is missing, or `check` and a statement does not hold.
    """
    draw = _draw() if plot is not None else None
    chosen = list(experiments) or list(EXPERIMENTS)
    extent = "full" if full else "sweep" if sweep else "short"
    found = _measured(chosen, extent) if saved is None else read(saved)
    if draw is not None and plot is not None:
        draw(found, plot)
    if check and (reasons := failed(found)):
        raise SystemExit("\n".join([report.text(found), *reasons]))
    return found


def read(saved: Path) -> dict[str, Any]:
    """A result as `--json` printed it: the last line."""
    found: dict[str, Any] = json.loads(saved.read_text().splitlines()[-1])
    return found


def _draw() -> Any:
    """The function that draws, before anything is measured in vain."""
    try:
        from bench.thesis.plots import draw  # noqa: PLC0415 - with the extra only
    except ImportError as error:
        raise SystemExit("rossec: error: plots need matplotlib\nhint: pip install rossec[bench]") from error
    return draw


def _measured(chosen: list[str], extent: str) -> dict[str, Any]:
    rows = dict[str, dict[str, Any]]()
    result: dict[str, Any] = {}
    if "5.1" in chosen:
        with tempfile.TemporaryDirectory() as folder:
            result["memory_mb"] = memory.measure(Path(folder))
    names = dict.fromkeys(name for each in chosen for name in EXPERIMENTS[each])
    for name in names:
        climbs = any(name in EXPERIMENTS[each] for each in chosen if each != "failures")
        rows[name], fails = _set_up(name, climbs=climbs, fails="failures" in chosen, extent=extent)
        if fails:
            result["failures"] = result.get("failures", {}) | fails
    if "mesh" in chosen:
        with tempfile.TemporaryDirectory() as folder:
            sizes = WHOLE_MESHES if extent == "full" else SHORT_MESHES
            result["mesh"] = meshes.measure(sizes, Path(folder))
    return combined({name: row for name, row in rows.items() if row}, result)


def _set_up(name: str, *, climbs: bool, fails: bool, extent: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The figures of a set-up, and what fails in it if it is the one for that."""
    with tempfile.TemporaryDirectory() as folder, setup(name, Path(folder)) as made:
        ladders = latency.EXTENTS[extent](name)
        found = latency.climb(made, ladders) if climbs else {}
        return found, failures.measure(made) if fails and name in EXPERIMENTS["failures"] else {}


def combined(rows: dict[str, dict[str, Any]], others: dict[str, Any]) -> dict[str, Any]:
    """The result: figures by kind, then by set-up, and the statements."""
    result = {
        "largest_at_1hz": {name: row["largest"] for name, row in rows.items()},
        "latency_ms": {name: row["latency_ms"] for name, row in rows.items()},
        "copies_on_link": {name: row["copies_on_link"] for name, row in rows.items()},
        "sealed_vs_plain": sealed_vs_plain(rows),
        **others,
    }
    ways = {name.partition("_")[0] for name in rows} & {"relay", "gateway"}
    return {
        **{key: value for key, value in result.items() if value},
        "statements": {way: judged(rows, way) for way in sorted(ways)},
    }


def sealed_vs_plain(rows: dict[str, dict[str, Any]]) -> dict[str, float]:
    """By size: mean latency of sealed messages divided by that of plain ROS on the same links."""
    sealed, plain = (
        {row["size"]: row["mean"] for row in rows.get(name, {}).get("latency_ms", ())}
        for name in ("direct_100m", "plain_100m")
    )
    return {str(size): round(sealed[size] / plain[size], 2) for size in plain if sealed.get(size)}
