"""Which words completion offers: only those that no shell and no terminal can take for more.

Names reach a home from elsewhere: from peers, by files that were carried. What has any other
character than these (a space, a quote, `$`, a control character) is not offered at all. `,` and tab
separate the fields of an answer. Pure.
"""

import re
from collections.abc import Iterable
from typing import Final

MAX_WORDS: Final = 2000
_WORD: Final = re.compile(r"[A-Za-z0-9/][A-Za-z0-9_./:+-]{0,299}", re.ASCII)


def is_offered(word: object) -> bool:
    """Whether completion may offer `word`."""
    return isinstance(word, str) and _WORD.fullmatch(word) is not None


def offered(words: Iterable[object], incomplete: str) -> list[str]:
    """Those of `words` that may be offered and begin with `incomplete`: sorted, each once."""
    found = {word for word in words if isinstance(word, str) and is_offered(word)}
    return sorted(word for word in found if word.startswith(incomplete))[:MAX_WORDS]
