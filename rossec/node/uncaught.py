"""A program that ends by a refusal of its node shows error and hint, as the command line does.

Only refusals: any other exception keeps its traceback. So does everything in Python's development
mode (`python -X dev`), and in a program that has set `sys.excepthook` itself.
"""

import sys
from types import TracebackType

from ca.errors import HintedError
from rossec.terminal import fail


def install() -> None:
    """Show refusals that nobody caught in this way, unless the program has a way of its own."""
    if sys.excepthook is sys.__excepthook__ and not sys.flags.dev_mode:
        sys.excepthook = show


def show(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    """Print what nobody caught, as `sys.excepthook` is called."""
    refusals = _refusals(error)
    if not refusals:
        sys.__excepthook__(kind, error, traceback)
    for refusal in refusals:
        fail(str(refusal), refusal.hint)


def _refusals(error: BaseException) -> list[HintedError]:
    """The refusals that `error` is made of; none if there is anything else in it."""
    if isinstance(error, HintedError):
        return [error]
    if not isinstance(error, BaseExceptionGroup):
        return []
    parts = [_refusals(part) for part in error.exceptions]
    return [refusal for part in parts for refusal in part] if all(parts) else []
