"""Completion in bash, zsh and fish: the script of each, and the answer to one press of Tab.

The scripts run the `rossec` that printed them, never what stands at the prompt. An answer is data:
no script evaluates, globs or splits a value. Each gives what was typed, up to the cursor, as
COMP_LINE. The scripts that click makes evaluate more: theirs for bash expands `*` in values.
"""

import shlex
from typing import Any, Final

import click
from click.shell_completion import CompletionItem, ShellComplete, split_arg_string

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


class _Shell(ShellComplete):
    """What was typed is split as a shell splits it, and nothing in it is expanded."""

    def __init__(self, group: click.Command, environment: Any) -> None:
        super().__init__(group, {"obj": environment}, "rossec", VARIABLE)
        self._variables = environment.variables

    def get_completion_args(self) -> tuple[list[str], str]:
        """The words after `rossec` that are complete, and the one that is being typed."""
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
        """Type, value and description, if there is one."""
        return "\t".join((item.type, item.value, *([item.help] if item.help else [])))


class _Bash(_Shell):
    """Bash shows no descriptions, and replaces only what stands behind the last `:` or `=`."""

    def get_completions(self, args: list[str], incomplete: str) -> list[CompletionItem[Any]]:
        """The end of each value, as bash inserts it."""
        found = super().get_completions(args, incomplete)
        typed = incomplete.partition("=")[2] if incomplete[:2] == "--" else incomplete
        kept = 0 if "COMP_LINE" not in self._variables else typed.rfind(":") + 1
        return [CompletionItem(item.value[kept:], item.type) for item in found]

    def format_completion(self, item: CompletionItem[Any]) -> str:
        """Type and value."""
        return f"{item.type},{item.value}"


_SCRIPTS: Final = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}
SHELLS: Final = tuple(_SCRIPTS)


def script(shell: str, program: str) -> str:
    """The script of a shell; `program` is run at each press of Tab."""
    return _SCRIPTS[shell] % {"program": shlex.quote(program)}


def answer(group: click.Command, environment: Any) -> str:
    """What completes the command line in `environment`; empty for a shell that is not known."""
    shell, _, instruction = environment.variables.get(VARIABLE, "").partition("_")
    if shell not in _SCRIPTS or instruction != "complete":
        return ""
    lines = (_Bash if shell == "bash" else _Shell)(group, environment).complete()
    return f"{lines}\n" if lines else ""
