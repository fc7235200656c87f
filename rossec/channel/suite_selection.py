"""The post-quantum policy as an operator writes it: ROSSEC_POST_QUANTUM, or an option that wins.

`off` means the classical suite alone, `prefer` the hybrid one with peers that support it, `require`
the hybrid one alone. Any other value refuses the program's start: a misspelt `require` must not
result in less.
"""

from collections.abc import Mapping
from typing import Final

from rossec.channel.edhoc.suites import POST_QUANTUM
from rossec.errors import ConfigurationError

VARIABLE: Final = "ROSSEC_POST_QUANTUM"
DEFAULT: Final = "off"
_ONE_OF: Final = f"one of: {', '.join(POST_QUANTUM)}"


def post_quantum(environ: Mapping[str, str], option: str | None = None) -> tuple[int, ...]:
    """The suites to offer and accept, in order of preference.

    Raises:
        ConfigurationError: neither `off`, `prefer` nor `require`; the hint has the nearest.
    """
    where, word = (VARIABLE, environ.get(VARIABLE, DEFAULT))
    if option is not None:
        where, word = "the post-quantum policy", option
    suites = POST_QUANTUM.get(word)
    if suites is None:
        import difflib  # noqa: PLC0415 - for mistakes alone

        near = difflib.get_close_matches(word.strip().lower(), POST_QUANTUM, 1, 0.5)
        hint = f"did you mean {near[0]}? {_ONE_OF}" if near else _ONE_OF
        raise ConfigurationError(f"{where} is {word!r}", hint)
    return suites
