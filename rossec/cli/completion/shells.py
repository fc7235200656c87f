"""Completion in bash, zsh and fish: the script of each, and the answer to one press of Tab.

The scripts run the `rossec` that printed them, never what stands at the prompt. An answer is data: no
script evaluates, globs or splits a value (those of click do: `*` in bash). Each gives what was typed,
up to the cursor, as COMP_LINE. Commands are completed by their outlines, and none is imported: a
wheel carries all outlines (`hatch_build.py`); in a source tree one is kept beside Python's own compiled
files when it was needed for the first time, until a file of the command line changes.
"""

import contextlib
import json
import os
import shlex
import shutil
import sys
from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any, Final

import click
from click.shell_completion import CompletionItem, ShellComplete, split_arg_string

from ca.errors import HintedError
from rossec.cli.completion import values
from rossec.terminal import say_block

COMMANDS: Final = Path(__file__).parents[1]
SHIPPED: Final = Path(__file__).with_name("outlines.json")
CACHE: Final = Path(__file__).parent / "__pycache__" / "outlines.json"
_FILES: Final = [CompletionItem("", type="file")]  # the shell looks them up
VARIABLE: Final = "_ROSSEC_COMPLETE"
_BASH: Final = """\
_rossec_completion() {
    local type value
    COMPREPLY=()
    while IFS=, read -r type value; do
        case $type in
            dir) compopt -o dirnames ;;
            file) compopt -o default ;;
            plain) COMPREPLY+=("$value") ;;
        esac
    done < <(COMP_LINE="${COMP_LINE:0:COMP_POINT}" \\
        _ROSSEC_COMPLETE=bash_complete %(program)s </dev/null 2>/dev/null)
}
complete -o nosort -F _rossec_completion rossec
"""
_ZSH: Final = """\
#compdef rossec
_rossec_completion() {
    local type value text
    local -a plain described files
    while IFS=$'\\t' read -r type value text; do
        case $type in
            dir) files=(-/) ;;
            file) files=(-f) ;;
            plain)
                if [[ -n $text ]]; then
                    described+=("${value//:/\\\\:}:$text")
                else
                    plain+=("$value")
                fi ;;
        esac
    done < <(COMP_LINE="${(j: :)words[1,CURRENT]}" \\
        _ROSSEC_COMPLETE=zsh_complete %(program)s </dev/null 2>/dev/null)
    (( $#described )) && _describe -V rossec described
    (( $#plain )) && compadd -a plain
    (( $#files )) && _path_files $files
    return 0
}
if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    _rossec_completion "$@"
else
    compdef _rossec_completion rossec
fi
"""
_FISH: Final = """\
function _rossec_completion
    set -lx COMP_LINE (commandline -cp | string join ' ')
    set -lx _ROSSEC_COMPLETE fish_complete
    for line in (%(program)s </dev/null 2>/dev/null)
        set -l parts (string split \\t -- $line)
        switch $parts[1]
            case dir
                __fish_complete_directories (commandline -ct)
            case file
                __fish_complete_path (commandline -ct)
            case plain
                string join \\t -- $parts[2..-1]
        end
    end
end
complete --no-files --command rossec --arguments '(_rossec_completion)'
"""
_SCRIPTS: Final = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
SHELLS: Final = tuple(_SCRIPTS)


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
def completion(shell: str) -> None:
    """Print what makes Tab complete commands and names in SHELL: bash, zsh or fish.

    For bash, add this line to ~/.bashrc; for zsh, with zsh for bash, to ~/.zshrc behind compinit:

    \b
      eval "$(rossec completion bash)"

    For fish, once:

    \b
      rossec completion fish > ~/.config/fish/completions/rossec.fish

    Names are those in ROSSEC_HOME, of what the last look at the graph showed (rossec topic list),
    and of the ROS packages here. Tab asks no master and no person.
    """
    say_block(script(shell, _program()).rstrip())


def script(shell: str, program: str) -> str:
    """The script of a shell; `program` is run at each press of Tab."""
    return _SCRIPTS[shell] % {"program": shlex.quote(program)}


def _program() -> str:
    path = Path(sys.argv[0])
    if path.name != "rossec":
        return "rossec"
    found = shutil.which(path)
    return "rossec" if found is None else str(Path(found).absolute())


class OutlineTable:
    def __init__(self, shipped: Path = SHIPPED, cache: Path = CACHE, commands: Path = COMMANDS) -> None:
        self._cache = cache
        self._stamp: str | None = None  # None: what is shipped does not age
        self._outlines = _read(shipped).get("outlines", {})
        if not self._outlines:
            self._stamp = _stamp(commands)
            found = _read(cache)
            self._outlines = found["outlines"] if found.get("stamp") == self._stamp else {}

    def get(self, place: str, load: Callable[[], click.Command]) -> values.Outline:
        if place not in self._outlines:
            self._outlines[place] = values.outline_of(load())
            if self._stamp is not None:
                self._keep()
        found: values.Outline = self._outlines[place]
        return found

    def _keep(self) -> None:
        # Write the cache; where it cannot be written, completion is slow and right.
        text = json.dumps({"stamp": self._stamp, "outlines": self._outlines})
        # Two presses of Tab may write at once: each its own file, and the last one stays.
        new = self._cache.with_name(f"{self._cache.name}.{os.getpid()}")
        with contextlib.suppress(OSError):
            self._cache.parent.mkdir(exist_ok=True)
            new.write_text(text)
            new.replace(self._cache)


def completed(
    name: str,
    place: str,
    load: Callable[[], click.Command],
    arguments: Iterable[str] = (),
    table: OutlineTable | None = None,
) -> click.Command:
    """The command `name` at `place`, to be completed: made of its outline, a group as it is."""
    found = outline(place, load, table)
    if "params" not in found:
        return load()
    return values.command_of(name, found, [*map(_values, values.kinds_of(place, arguments, found))])


def outline(
    place: str, load: Callable[[], click.Command], table: OutlineTable | None = None
) -> values.Outline:
    """The outline of the command at `place`; `load` imports it if that is needed."""
    return (table or _table()).get(place, load)


@cache
def _table() -> OutlineTable:
    return OutlineTable()


def _values(kind: str) -> values.Values | None:
    return None if kind == values.FREE else partial(_offer, kind)


def _offer(
    kind: str, context: click.Context, _param: click.Parameter, incomplete: str
) -> list[CompletionItem[Any]]:
    if kind == values.COMMAND:
        return _FILES
    from rossec.cli.completion.sources import Sources  # noqa: PLC0415 - not needed for options

    environment = context.obj
    try:
        sources = Sources(environment.home, environment.variables)
    except HintedError:  # a home that others could have written
        return []
    found = [word for read in values.KINDS[kind] for word in read(sources)]
    return [CompletionItem(word) for word in values.offered(found, incomplete)]


def answer(group: click.Command, environment: Any) -> str:
    """What completes the command line in `environment`; empty for a shell that is not known."""
    shell, _, instruction = environment.variables.get(VARIABLE, "").partition("_")
    if shell not in _SCRIPTS or instruction != "complete":
        return ""
    lines = (_Bash if shell == "bash" else _Shell)(group, environment).complete()
    return f"{lines}\n" if lines else ""


class _Shell(ShellComplete):
    def __init__(self, group: click.Command, environment: Any) -> None:
        super().__init__(group, {"obj": environment}, "rossec", VARIABLE)
        self._variables = environment.variables

    def get_completion_args(self) -> tuple[list[str], str]:
        line = self._variables.get("COMP_LINE")
        if line is None:  # as the scripts of click have it
            words = split_arg_string(self._variables["COMP_WORDS"])
            words = [*words, ""][: int(self._variables["COMP_CWORD"]) + 1]
        else:
            words = split_arg_string(line)
            if not words or line[-1:].isspace():
                words.append("")
        return words[1:-1], words[-1]

    def format_completion(self, item: CompletionItem[Any]) -> str:
        return "\t".join((item.type, item.value, *([item.help] if item.help else [])))


class _Bash(_Shell):
    def get_completions(self, args: list[str], incomplete: str) -> list[CompletionItem[Any]]:
        found = super().get_completions(args, incomplete)
        typed = incomplete.partition("=")[2] if incomplete[:2] == "--" else incomplete
        # Readline breaks words at `:`, which aliases have (hospital:/pose): what stands before is typed.
        kept = 0 if "COMP_LINE" not in self._variables else typed.rfind(":") + 1
        return [CompletionItem(item.value[kept:], item.type) for item in found]

    def format_completion(self, item: CompletionItem[Any]) -> str:
        return f"{item.type},{item.value}"


def _read(path: Path) -> dict[str, Any]:
    # A table in a file; empty if it cannot be read.
    try:
        with path.open("rb") as stream:
            found = json.loads(stream.read(1024 * 1024))
    except (OSError, ValueError):
        return {}
    whole = isinstance(found, dict) and isinstance(found.get("outlines"), dict)
    return found if whole else {}


def _stamp(directory: Path) -> str:
    files = [
        entry.stat()
        for folder in [directory, *filter(Path.is_dir, directory.iterdir())]
        if folder.name != "__pycache__"
        for entry in os.scandir(folder)
        if entry.name.endswith(".py")
    ]
    newest = max(status.st_mtime_ns for status in files)
    return f"{len(files)} {newest} {sum(status.st_size for status in files)}"
