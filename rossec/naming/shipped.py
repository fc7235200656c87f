"""The rules and examples that are shipped: those of the thesis (appendix A)."""

from importlib.resources import files
from typing import Final

RULES: Final = "names.xsl"


def rules(name: str = RULES) -> bytes:
    """The shipped rules `name`."""
    return files("rossec.naming").joinpath("rules", name).read_bytes()


def example(name: str) -> bytes:
    """The shipped example `name`: metadata `phone.xml`."""
    return files("rossec.naming").joinpath("examples", name).read_bytes()
