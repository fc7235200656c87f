"""`python -m bench [NAME] [--json] [--seconds N]`: run one benchmark, or all of them.

A benchmark is a module of this package with `measure(seconds) -> dict`. With `--json` the last line
of the output is the result on one line; otherwise it is a table for people. A benchmark with
options of its own has a `PARSER`, and takes what that finds as keywords; `text` is its own table.
"""

import argparse
import importlib
import json
import pkgutil
import sys
from collections.abc import Sequence
from typing import Any

import bench


def names() -> list[str]:
    """Every benchmark there is."""
    return sorted(m.name for m in pkgutil.iter_modules(bench.__path__) if m.name[0] != "_")


def table(result: dict[str, Any], indent: str = "") -> str:
    """The result as indented lines, one figure each."""
    lines = []
    for key, value in result.items():
        if isinstance(value, dict):
            lines.append(f"{indent}{key}:\n{table(value, indent + '  ')}")
        else:
            lines.append(f"{indent}{key:<32} {value}")
    return "\n".join(lines)


def parse(words: Sequence[str]) -> tuple[argparse.Namespace, dict[str, Any]]:
    """What the command line says, and what it says to the benchmark that it names."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("name", nargs="?", choices=names(), help="one of them; all without it")
    parser.add_argument("--json", action="store_true", help="one line of JSON at the end")
    parser.add_argument("--seconds", type=float, default=20.0, help="about how long for each")
    options, rest = parser.parse_known_args(words)
    module = importlib.import_module(f"bench.{options.name}") if options.name else None
    own: argparse.ArgumentParser | None = getattr(module, "PARSER", None)
    if own is None and rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    return options, {} if own is None else vars(own.parse_args(rest))


def main(words: Sequence[str] | None = None) -> None:
    """Run what the command line names."""
    options, given = parse(sys.argv[1:] if words is None else words)
    for name in [options.name] if options.name else names():
        print(f"== {name}")
        module = importlib.import_module(f"bench.{name}")
        result = module.measure(options.seconds, **given)
        print(json.dumps(result) if options.json else getattr(module, "text", table)(result))


if __name__ == "__main__":
    main()
