"""The house rules: sizes, docstrings where something is offered, class names (docs/decisions/0057)."""

import ast
import itertools
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
PACKAGES: Final = ("ca", "grants", "rossec")
PRODUCT: Final = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
TREES: Final = {path: ast.parse(path.read_text()) for path in PRODUCT}
Function = ast.FunctionDef | ast.AsyncFunctionDef

MODULES: Final = 480
FILE_LINES: Final = 700
LONGER: Final[dict[str, str]] = {}
"""Files of more lines, each with the reason why it is one story."""
BODY_LINES: Final = 25
"""Nine of ten functions have at most so many lines in their bodies."""
SAME_NAMES: Final[dict[str, str]] = {}
"""Public class names that are defined more than once, each with the reason."""


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def bodies() -> Iterator[int]:
    """How many lines the body of each function has, without its docstring."""
    for node in itertools.chain.from_iterable(map(ast.walk, TREES.values())):
        if isinstance(node, Function):
            body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
            yield (node.end_lineno or node.lineno) - body[0].lineno + 1


def test_there_are_no_more_modules_than_a_reader_can_find() -> None:
    assert len(PRODUCT) <= MODULES


def test_nine_of_ten_functions_are_short() -> None:
    sizes = sorted(bodies())
    assert sizes[len(sizes) * 9 // 10] <= BODY_LINES


def test_a_long_file_has_its_reason() -> None:
    long = {named(path) for path in PRODUCT if len(path.read_text().splitlines()) > FILE_LINES}
    assert long == set(LONGER)


def test_a_module_begins_with_its_rule() -> None:
    rules = {named(path): ast.get_docstring(tree) for path, tree in TREES.items()}
    assert [name for name, text in rules.items() if not text] == []


def offered(face: Path) -> list[str]:
    """What the `__all__` of a package names."""
    for node in TREES[face].body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def undocumented(face: Path) -> Iterator[str]:
    """Functions and classes that the package offers, and methods of these, without a docstring."""
    names = set(offered(face))
    for path in face.parent.rglob("*.py"):
        for node in TREES[path].body:
            if not isinstance(node, Function | ast.ClassDef) or node.name not in names:
                continue
            if not ast.get_docstring(node):
                yield f"{named(path)}: {node.name}"


def test_what_a_package_offers_is_documented() -> None:
    faces = [path for path in PRODUCT if path.name == "__init__.py" and offered(path)]
    assert faces
    assert [found for face in faces for found in undocumented(face)] == []


def test_a_public_class_name_is_defined_once() -> None:
    places = defaultdict(list)
    for path, tree in TREES.items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(named(path))
    several = {name: where for name, where in places.items() if len(where) > 1}
    assert {name: where for name, where in several.items() if name not in SAME_NAMES} == {}
    assert SAME_NAMES.keys() <= several.keys()


FORMS: Final = ("node", "inprocess", "sidecar")
EQUAL_LINES: Final = 12
"""The longest run of equal lines in two forms of a node; more is one idea, for `participant`."""


def significant_lines(path: Path) -> list[str]:
    """Stripped lines, without blank ones and imports."""
    text = path.read_text()
    imported = {
        number
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.stmt) and type(node).__name__.startswith("Import")
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [line for number, line in lines if line and number not in imported]


def runs(form: str, length: int) -> dict[tuple[str, ...], str]:
    """Every run of so many lines in a form, with a file it is in."""
    return {
        tuple(lines[start : start + length]): named(path)
        for path in sorted((ROOT / "rossec" / form).rglob("*.py"))
        for lines in [significant_lines(path)]
        for start in range(len(lines) - length + 1)
    }


def equal_runs(length: int) -> list[tuple[str, str, str]]:
    found = {form: runs(form, length) for form in FORMS}
    return [
        (found[one][run], found[other][run], run[0])
        for one, other in itertools.combinations(FORMS, 2)
        for run in found[one].keys() & found[other].keys()
    ]


def test_no_form_of_a_node_repeats_another() -> None:
    assert equal_runs(EQUAL_LINES + 1) == []


def test_a_repeated_line_is_found() -> None:
    assert equal_runs(1)
