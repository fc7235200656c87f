"""`make demo` installs what rossec itself needs, and nothing of development."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
PROJECT: Final = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_demo_asks_for_no_package_of_development() -> None:
    makefile, script = (ROOT / "Makefile").read_text(), (ROOT / "tools" / "venv.sh").read_text()
    assert re.search(r"^demo: \$\(RUNTIME\)$", makefile, re.MULTILINE)
    assert re.search(r"^\$\(RUNTIME\):.*\n\t@tools/venv\.sh runtime$", makefile, re.MULTILINE)
    assert "made=runtime what=. " in script


def test_the_demo_imports_nothing_but_run_time_packages() -> None:
    """Neither an extra nor what tests need: it would fail where only those are installed."""
    allowed = {re.split(r"[^a-z0-9-]", each)[0] for each in PROJECT["dependencies"]}
    extras = (
        {
            re.split(r"[^a-z0-9-]", each)[0].replace("-", "_")
            for name, group in PROJECT["optional-dependencies"].items()
            if name != "all"
            for each in group
        }
        - allowed
        - {"rossec"}
    )
    program = (
        "import sys\n"
        f"blocked = {sorted(extras | {'zenoh', 'fido2', 'PIL', 'zxingcpp', 'lxml', 'lakers'})!r}\n"
        "sys.modules.update(dict.fromkeys(blocked))\n"
        "from rossec.__main__ import main\n"
        "sys.argv = ['rossec', 'demo', '--help']\n"
        "import rossec.demo.steps, rossec.demo.robot, rossec.demo.environment\n"
        "main()\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stderr
    assert "Usage: rossec demo" in ended.stdout
