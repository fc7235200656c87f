"""Outlines of commands, as JSON values, and which names complete which of their arguments.

What completes a command line needs no more, while the module of the command takes half a second to
import. A command made of an outline has no callback: it can only be completed. Names reach a home
from elsewhere, so a word is offered only if no shell and no terminal can take it for more; `,` and
tab separate the fields of an answer. What a kind reads is asked of `sources.Sources`.
"""

import contextlib
import itertools
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from operator import methodcaller
from pathlib import Path
from typing import Any, Final

import click

from ca.errors import HintedError
from ca.keys import ownership

MAX_WORDS: Final = 2000
# Names come from elsewhere: nothing that a shell or terminal could execute (attack `hostile-completion`).
_WORD: Final = re.compile(r"[A-Za-z0-9/][A-Za-z0-9_./:+-]{0,299}", re.ASCII)
# Written after a command has asked the master with an identity, so that Tab asks nobody. Readable by its
# owner only: what a node may see of the graph is not for every user of the host.
NAME: Final = "completion.json"
TOPIC: Final = "topic"
SERVICE: Final = "service"
NODE: Final = "node"
TYPE: Final = "type"
_MAX: Final = 1024 * 1024
Outline = dict[str, Any]
Values = Callable[[click.Context, click.Parameter, str], list[Any]]
Read = Callable[[Any], Iterator[object]]  # of `sources.Sources`
FREE: Final = "free"  # nothing to offer: a new name, a pattern, a value
COMMAND: Final = "command"
# Options mean the same in all commands, but for those in `_OTHERWISE`.
OPTIONS: Final = {
    "--as": "own node",
    "--border": "recorded node",
    "--call": "service",
    "--from-graph": "own node",
    "--graph": "node",
    "--node": "node",
    "--provide": "service",
    "--publish": "topic",
    "--replace": "thing",
    "--replace-key": "recorded node",
    "--subscribe": "topic",
    "--to": "recorded node",
    "--topic": "topic",
}
_OTHERWISE: Final = {
    ("domain:accept", "--as"): FREE,
    ("sites:add_site", "--as"): FREE,
    ("sites:add_site", "--domain"): "domain",
    ("grant.sign:narrow", "--as"): "own node",
    ("ros.calls:call", "--type"): "service type",
}
_OWN: Final = methodcaller("own_nodes")
_WRITTEN: Final = methodcaller("written")
_NODES: Final = methodcaller("recorded", "node")
_TOPICS: Final = methodcaller("seen", TOPIC)
_SERVICES: Final = methodcaller("seen", SERVICE)
KINDS: Final[dict[str, tuple[Read, ...]]] = {
    FREE: (),
    COMMAND: (),
    "domain": (methodcaller("recorded", "domain"),),
    "grant": (methodcaller("recorded", "grant"), methodcaller("held_grants")),
    "grant request": (methodcaller("recorded", "grant request"),),
    "invitation": (methodcaller("recorded", "invitation"),),
    "message type": (methodcaller("seen", TYPE), methodcaller("known_types"), methodcaller("types", "msg")),
    "node": (_OWN, _NODES, methodcaller("seen", NODE), _WRITTEN),
    "own node": (_OWN,),
    "phone": (methodcaller("recorded", "phone"),),
    "recorded node": (_NODES,),
    "recorded node or thing": (_NODES, methodcaller("recorded", "thing")),
    "request": (methodcaller("recorded", "request"),),
    "right": (methodcaller("rights"),),
    "running node": (methodcaller("seen", NODE),),
    "service": (_SERVICES, _WRITTEN),
    "service type": (methodcaller("types", "srv"),),
    "thing": (methodcaller("recorded", "thing"),),
    "topic": (_TOPICS, _WRITTEN),
    "topic or service": (_TOPICS, _SERVICES, _WRITTEN),
}
"""What is read for a kind, all of it together."""


def offered(words: Iterable[object], incomplete: str) -> list[str]:
    found = {word for word in words if isinstance(word, str) and is_offered(word)}
    return sorted(word for word in found if word.startswith(incomplete))[:MAX_WORDS]


def is_offered(word: object) -> bool:
    return isinstance(word, str) and _WORD.fullmatch(word) is not None


def keep(home: Path, master: str, names: Mapping[str, Iterable[str]]) -> None:
    """Keep the names of each kind, as the master at the URI `master` gave them.

    A home that cannot be written is no failure of the command that looked.
    """
    from rossec import files  # noqa: PLC0415 - not needed to read

    # A master may name anything: only what no shell can take for more is kept.
    kept = {kind: [*filter(is_offered, found)][:MAX_WORDS] for kind, found in names.items()}
    data = json.dumps({"master": master, "names": kept}).encode()
    with contextlib.suppress(OSError, HintedError):
        files.replace(home / NAME, data, 0o600)


def read(home: Path, master: str, kind: str) -> list[object]:
    """The names of a kind; none if the last look was at another master."""
    try:
        with os.fdopen(ownership.open_trusted(home / NAME), "rb") as stream:
            found = json.loads(stream.read(_MAX))
    except (OSError, HintedError, ValueError):
        return []
    match found:
        # The names of another master would be wrong here.
        case {"master": str() as uri, "names": {**names}} if uri == master:
            words = names.get(kind)
            return words if isinstance(words, list) else []
    return []


def outline_of(command: click.Command) -> Outline:
    """The outline of a command; of a group its help line alone."""
    line = {"help": command.get_short_help_str(1000)}  # no help line is cut
    if isinstance(command, click.Group):
        return line
    return {
        **line,
        "params": [_param(each) for each in command.params if not getattr(each, "hidden", False)],
        "interspersed": command.allow_interspersed_args,
        "unknown": command.ignore_unknown_options,
    }


def _param(param: click.Parameter) -> Outline:
    found: Outline = {"name": param.name, "nargs": param.nargs}
    if isinstance(param.type, click.Choice):
        found["choices"] = [str(each) for each in param.type.choices]
    elif isinstance(param.type, click.Path):
        found["path"] = ("file", "dir")[param.type.dir_okay and not param.type.file_okay]
    else:
        found["text"] = param.type.name == "text"
    if isinstance(param, click.Option):
        found |= {
            "opts": list(param.opts),
            "others": list(param.secondary_opts),
            "flag": param.is_flag or param.count,
            "multiple": param.multiple,
            "help": param.help or "",
        }
    return found


def command_of(name: str, outline: Outline, values: Sequence[Values | None]) -> click.Command:
    """A command to be completed; `values` complete its params, in their order."""
    params = [*map(_parameter, outline["params"], values)]
    settings = {
        "allow_interspersed_args": outline["interspersed"],
        "ignore_unknown_options": outline["unknown"],
    }
    return click.Command(name, params=params, context_settings=settings)


def _parameter(outline: Outline, complete: Values | None) -> click.Parameter:
    kind: click.ParamType[Any] = click.STRING
    if "choices" in outline:
        kind = click.Choice(outline["choices"])
    elif "path" in outline:
        kind = click.Path(file_okay=outline["path"] == "file", dir_okay=True)
    if "opts" not in outline:
        return click.Argument(
            [outline["name"]], nargs=outline["nargs"], type=kind, required=False, shell_complete=complete
        )
    if outline["flag"]:
        pairs = itertools.zip_longest(outline["opts"], outline["others"], fillvalue="")
        flags = [f"{one}/{other}" if other else one for one, other in pairs]
        return click.Option([outline["name"], *flags], is_flag=True, help=outline["help"])
    return click.Option(
        [outline["name"], *outline["opts"]],
        nargs=outline["nargs"],
        type=kind,
        multiple=outline["multiple"],
        help=outline["help"],
        shell_complete=complete,
    )


def kinds_of(place: str, arguments: Iterable[str], outline: Outline) -> list[str]:
    """The kind of each param; `arguments` are those of the arguments that are text, in their order."""
    left = iter(arguments)

    def kind(param: Outline) -> str:
        if "opts" not in param:
            return next(left, FREE) if param.get("text") else FREE
        found = (_OTHERWISE.get((place, each)) or OPTIONS.get(each) for each in param["opts"])
        return next(filter(None, found), FREE)

    return list(map(kind, outline["params"]))
