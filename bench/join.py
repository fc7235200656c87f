"""From an invitation to a policy in force: what joining, applying and delivering cost."""

from bench import _applied, _deliver


def measure(seconds: float) -> dict[str, object]:  # noqa: ARG001  (each part has its own size)
    """CPU seconds of `policy apply` by the number of nodes; delivery to a hundred running ones."""
    applied = {str(size): _applied.apply_s(size) for size in _applied.SIZES}
    return {
        "apply_s": {size: figures["changed"] for size, figures in applied.items()},
        "apply_unchanged_s": {size: figures["unchanged"] for size, figures in applied.items()},
        **_deliver.figures(),
    }
