"""How much of each module the tests of its own folder cover: `make report`, after `make cover`.

The own tests of `rossec/a/b.py` are the files of `tests/rossec/a` that import it. `tests/conftest.py` has
coverage record which file a line ran for, in the programs that a test starts too. Only statements and
branches inside functions count: the others run when anything imports the module.
"""

import json
import re
import tempfile
from pathlib import Path
from typing import Final

import coverage

ROOT: Final = Path(__file__).parents[1]
LEAST: Final = 80  # percent: what is below is printed


def own_tests(module: Path) -> list[str]:
    """The test files of the module, as paths from the root."""
    package = re.escape(module.parent.as_posix().replace("/", "."))
    imported = re.compile(rf"{package}\.{module.stem}\b|from {package} import [^\n]*\b{module.stem}\b")
    tests = sorted((ROOT / "tests" / module.parent).glob("test_*.py"))
    return [path.relative_to(ROOT).as_posix() for path in tests if imported.search(path.read_text())]


def covered(measured: coverage.Coverage, path: Path) -> float | None:
    """Percent of its functions' statements and branches, or None without any."""
    contexts = [f"^{re.escape(test)}$" for test in own_tests(path.relative_to(ROOT))]
    with tempfile.NamedTemporaryFile("r") as report:
        measured.json_report(morfs=[str(path)], contexts=contexts or ["^no test$"], outfile=report.name)
        (found,) = json.load(report)["files"].values()
    functions = [each["summary"] for name, each in found["functions"].items() if name]
    count, hit = (
        sum(each[lines] + each[branches] for each in functions)
        for lines, branches in (("num_statements", "num_branches"), ("covered_lines", "covered_branches"))
    )
    return 100 * hit / count if count else None


def main() -> None:
    """Print the modules that their own tests cover least, the least first."""
    measured = coverage.Coverage()
    measured.load()
    files = [Path(path) for path in measured.get_data().measured_files()]
    found = [(percent, path) for path in files if (percent := covered(measured, path)) is not None]
    for percent, path in sorted(found):
        if percent < LEAST:
            print(f"{percent:3.0f} %  {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
