"""From an invitation to a policy in force: what joining, applying and delivering cost."""

from bench import _applied, _deliver, _joins


def measure(seconds: float) -> dict[str, object]:  # noqa: ARG001  (each part has its own size)
    """Joins a second, CPU seconds of `policy apply` by the number of nodes, and delivery."""
    applied = {str(size): _applied.apply_s(size) for size in _applied.SIZES}
    return {
        **_joins.figures(),
        "apply_s": {size: figures["changed"] for size, figures in applied.items()},
        "apply_unchanged_s": {size: figures["unchanged"] for size, figures in applied.items()},
        **_deliver.figures(),
    }
