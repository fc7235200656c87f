"""`python -m bench [NAME] [--json] [--seconds N]`: run one benchmark, or all of them.

A benchmark is a module of this package with `measure(seconds) -> dict`. With `--json` the last line
of the output is the result on one line; otherwise it is a table for people.
"""

import argparse
import importlib
import json
import pkgutil
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


def main() -> None:
    """Run what the command line names."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("name", nargs="?", choices=names(), help="one of them; all without it")
    parser.add_argument("--json", action="store_true", help="one line of JSON at the end")
    parser.add_argument("--seconds", type=float, default=20.0, help="about how long for each")
    options = parser.parse_args()
    for name in [options.name] if options.name else names():
        print(f"== {name}")
        result = importlib.import_module(f"bench.{name}").measure(options.seconds)
        print(json.dumps(result) if options.json else table(result))


if __name__ == "__main__":
    main()
