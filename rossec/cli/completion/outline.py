"""The outline of a command: its options and arguments as JSON values, and a command made of them.

Pure. What completes a command line needs no more than that, while the module of the command takes
half a second to import. A command made of an outline has no callback: it can only be completed.
"""

import itertools
from collections.abc import Callable, Sequence
from typing import Any, Final

import click

Outline = dict[str, Any]
Values = Callable[[click.Context, click.Parameter, str], list[Any]]
_FILES: Final = ("file", "dir")


def outline_of(command: click.Command) -> Outline:
    """The outline of a command that is no group."""
    return {
        "params": [_param(each) for each in command.params if not getattr(each, "hidden", False)],
        "interspersed": command.allow_interspersed_args,
        "unknown": command.ignore_unknown_options,
    }


def command_of(name: str, outline: Outline, values: Sequence[Values | None]) -> click.Command:
    """A command to be completed; `values` complete its params, in their order.

    Raises:
        KeyError, TypeError: not an outline.
    """
    params = [*map(_parameter, outline["params"], values)]
    settings = {
        "allow_interspersed_args": outline["interspersed"],
        "ignore_unknown_options": outline["unknown"],
    }
    return click.Command(name, params=params, context_settings=settings)


def _param(param: click.Parameter) -> Outline:
    found: Outline = {"name": param.name, "nargs": param.nargs} | _type(param.type)
    if isinstance(param, click.Option):
        found |= {
            "opts": list(param.opts),
            "others": list(param.secondary_opts),
            "flag": param.is_flag or param.count,
            "multiple": param.multiple,
            "help": param.help or "",
        }
    return found


def _type(kind: click.ParamType[Any]) -> Outline:
    if isinstance(kind, click.Choice):
        return {"choices": [str(each) for each in kind.choices]}
    if isinstance(kind, click.Path):
        return {"path": _FILES[kind.dir_okay and not kind.file_okay]}
    return {"text": kind.name == "text"}


def _parameter(outline: Outline, complete: Values | None) -> click.Parameter:
    kind = _made_type(outline)
    if "opts" not in outline:
        return click.Argument(
            [outline["name"]], nargs=outline["nargs"], type=kind, required=False,
            shell_complete=complete,
        )  # fmt: skip
    if outline["flag"]:
        return click.Option([outline["name"], *_flags(outline)], is_flag=True, help=outline["help"])
    return click.Option(
        [outline["name"], *outline["opts"]], nargs=outline["nargs"], type=kind,
        multiple=outline["multiple"], help=outline["help"], shell_complete=complete,
    )  # fmt: skip


def _flags(outline: Outline) -> list[str]:
    """As click declares them: `--yes/--no`."""
    pairs = itertools.zip_longest(outline["opts"], outline["others"], fillvalue="")
    return [f"{one}/{other}" if other else one for one, other in pairs]


def _made_type(outline: Outline) -> click.ParamType[Any]:
    if "choices" in outline:
        return click.Choice(outline["choices"])
    if "path" in outline:
        return click.Path(file_okay=outline["path"] == "file", dir_okay=True)
    return click.STRING
