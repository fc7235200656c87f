"""The short form `<parameter name path? default>` of rules, expanded into XSLT. Pure.

It is the thesis's: a variable with the text of the node at `path` (by default the child `name`),
or `default` where there is none. Nothing but space is none. A default with characters that ROS has
not in names gets `_` for each of them, unless the thesis's own defaults are asked for.
"""

import re
from typing import Any, Final

from rossec.errors import RulesRefused

XSLT: Final = "http://www.w3.org/1999/XSL/Transform"
PARAMETER: Final = "parameter"
_ILLEGAL: Final = re.compile(r"[^A-Za-z0-9_/]")
_NAME: Final = re.compile(r"[A-Za-z_][\w.-]*", re.ASCII)
_KNOWN: Final = frozenset({"name", "path", "default"})
_HINT: Final = 'write <parameter name="group" path="//node/group" default="unknown_group"/>'


def expand(root: Any, *, thesis_defaults: bool = False) -> None:
    """Replace every `<parameter>` in the tree of lxml below `root`, which is changed.

    Raises:
        RulesRefused: one without a name, or with anything that is not of the short form.
    """
    for element in list(root.iter(PARAMETER)):
        _check(element)
        _replace(element, _default(element.get("default", ""), keep=thesis_defaults))


def _check(element: Any) -> None:
    unknown = sorted(set(element.attrib) - _KNOWN)
    if unknown or len(element) or (element.text or "").strip():
        raise RulesRefused(f"line {element.sourceline}: <parameter> has more than it may", _HINT)
    if _NAME.fullmatch(element.get("name", "")) is None:
        raise RulesRefused(f"line {element.sourceline}: <parameter> without a name", _HINT)
    if not element.get("path", "x").strip():
        raise RulesRefused(f"line {element.sourceline}: <parameter> with an empty path", _HINT)


def _default(text: str, *, keep: bool) -> str:
    return text if keep else _ILLEGAL.sub("_", text)


def _replace(element: Any, default: str) -> None:
    """Make the variable in the place of `element`; errors in it name the line of the short form."""
    name = element.get("name")
    path = element.get("path", name)
    variable = element.makeelement(f"{{{XSLT}}}variable", {"name": name})
    choose = _child(variable, "choose")
    given = _child(choose, "when", {"test": f"normalize-space({path}) != ''"})
    _child(given, "value-of", {"select": f"normalize-space({path})"})
    _child(_child(choose, "otherwise"), "text").text = default
    for made in variable.iter():
        made.sourceline = element.sourceline
    variable.tail = element.tail
    element.getparent().replace(element, variable)


def _child(parent: Any, name: str, attributes: dict[str, str] | None = None) -> Any:
    made = parent.makeelement(f"{{{XSLT}}}{name}", attributes or {})
    parent.append(made)
    return made
