"""What `import rossec` promises: no foreign sibling, and nothing loaded before it is used."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import rossec


@pytest.mark.parametrize("package", ["ca", "grants"])
def test_a_foreign_package_ends_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text("print('imported')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    command = [sys.executable, "-c", "import rossec"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    lines = done.stderr.splitlines()
    assert lines[0].startswith(f"rossec: error: a foreign package {package!r} ({tmp_path}")
    assert "PYTHONPATH" in lines[1]


def test_an_older_python_is_told_of_the_sidecar() -> None:
    """Python 3.8 of Ubuntu 20.04 reads this file, and must not read any other."""
    older = "import sys; sys.version_info = (3, 8, 10); import rossec"
    done = subprocess.run([sys.executable, "-I", "-c", older], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    error, hint = done.stderr.splitlines()
    assert error == "rossec: error: Python 3.11 or newer is needed, and this is Python 3.8"
    assert "sidecar" in hint
    ast.parse(Path(rossec.__file__).read_text(), feature_version=(3, 8))


def test_a_program_that_only_imports_it_loads_nothing_else() -> None:
    shown = "import rossec, sys; print([name for name in sys.modules if name[:7] == 'rossec.'])"
    command = [sys.executable, "-I", "-c", shown]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout == "[]\n"


def test_its_two_functions_are_imported_on_first_use() -> None:
    from rossec.inprocess.request import ask
    from rossec.inprocess.secure import secure

    assert (rossec.ask, rossec.secure) == (ask, secure)
    with pytest.raises(AttributeError, match="module 'rossec' has no attribute 'open'"):
        _ = rossec.open
