"""Parameters of other masters, read-only below `/remote/<label>`. Pure.

Each has one writer, its origin, so there is no conflict and nothing circulates. `/` remains the own
tree alone: a node that reads or sets it reaches no mirror.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from ca.domains.aliases import REMOTE, check_label, is_alias
from ca.errors import NameRefused
from rossec.errors import ImportRefused
from rossec.master.state.parameters import Parameters, TooLarge, check_names
from rossec.master.state.sites import Site
from rossec.ros import names

MIRROR_LIMIT: Final = 1024 * 1024  # bytes of the parameters of one site


class MirrorChange(NamedTuple):
    """A parameter, or a namespace, that has changed; value `{}`: it is gone."""

    key: str
    value: object


class _Mirror(NamedTuple):
    site: Site
    parameters: Parameters


class Mirrors:
    """The parameters of all sites.

    Args:
        limit: bytes of the parameters of one site.
    """

    def __init__(self, limit: int = MIRROR_LIMIT) -> None:
        self._limit = limit
        self._mirrors: dict[str, _Mirror] = {}

    def replace(self, site: Site, tree: dict[str, object]) -> list[MirrorChange]:
        """Take over all that is mirrored of a site; returns what has changed.

        Args:
            tree: with the names of the origin, from its root.

        Raises:
            ImportRefused: invalid, or too large; what was mirrored before stays.
        """
        new = Parameters()
        try:
            check_names(names.SEPARATOR, tree)
            new.set(names.SEPARATOR, tree, self._limit)
        except TooLarge as error:
            raise ImportRefused(
                f"the parameters of site {site.label} take more than {self._limit} bytes",
                "mirror fewer: `rossec federation param`",
            ) from error
        except (TypeError, ValueError) as error:
            raise ImportRefused(f"parameters of site {site.label}: {error}") from error
        if REMOTE[1:] in tree:
            raise ImportRefused(f"site {site.label} names what it mirrors itself")
        old = self._mirrors.get(site.check().label)
        before = _root(old.parameters) if old is not None and old.site == site else {}
        events = [] if old is None or old.site == site else self.drop(site.label)
        self._mirrors[site.label] = _Mirror(site, new)
        return [*events, *_changes(_namespace(site), before, _root(new))]

    def drop(self, label: str) -> list[MirrorChange]:
        """Forget what is mirrored of a site."""
        held = self._mirrors.pop(label, None)
        if held is None:
            return []
        return [*_changes(_namespace(held.site), _root(held.parameters), {})]

    def item(self, key: str) -> tuple[str, object]:
        """`key` and its value, or None: as `Parameters.item`, for keys below `/remote`."""
        namespace, slash, rest = key.removeprefix(f"{REMOTE}/").partition(names.SEPARATOR)
        for _, (site, parameters) in sorted(self._mirrors.items()):
            if site.namespace == namespace and is_alias(key):
                value = parameters.item(f"{slash}{rest}" or names.SEPARATOR)[1]
                if value is not None:
                    return key, value
        return key, None

    def items(self) -> Iterator[tuple[str, object]]:
        """The tree of each namespace."""
        for namespace in dict.fromkeys(held.site.namespace for held in self._mirrors.values()):
            yield self.item(f"{REMOTE}/{namespace}")


def refuse_mirror(key: str, value: object = None) -> None:
    """Return if setting `key` to `value`, or unsetting it, reaches nothing below `/remote`.

    Raises:
        NameRefused: it does.
    """
    below_root = key == names.SEPARATOR and isinstance(value, dict) and REMOTE[1:] in value
    if is_alias(key) or below_root:
        raise NameRefused(
            f"{REMOTE if below_root else key} stands for parameters of other masters, "
            "which are only read here",
            "set it at its own master",
        )


def _namespace(site: Site) -> str:
    return f"{REMOTE}/{check_label(site.namespace)}"


def _root(parameters: Parameters) -> dict[str, object]:
    root = parameters.get(names.SEPARATOR)
    return root if isinstance(root, dict) else {}


def _changes(
    key: str, before: dict[str, object], after: dict[str, object]
) -> Iterator[MirrorChange]:
    for name in dict.fromkeys((*before, *after)):
        old, new, inner = before.get(name), after.get(name), f"{key}/{name}"
        if old == new:
            continue
        if isinstance(old, dict) and isinstance(new, dict) and old and new:
            yield from _changes(inner, old, new)
        else:
            yield MirrorChange(inner, {} if new is None else new)
