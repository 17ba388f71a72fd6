"""Packages that one command alone needs, and the extra that installs them."""

from importlib.util import find_spec

from tacgen.core.errors import TacgenError

EXTRAS = {
    "learn": ("torch", "transformers", "safetensors", "sklearn", "tensorboard"),
    "parquet": ("pyarrow",),
    "cluster": ("submitit",),
    "view": ("rerun",),
    "batch": ("warp",),
    "gym": ("gymnasium",),
}


def missing_extra(extra: str, purpose: str) -> str:
    """What ``purpose`` lacks of ``extra`` and how to install it; empty if nothing is missing."""
    missing = [name for name in EXTRAS[extra] if find_spec(name) is None]
    if not missing:
        return ""
    return (
        f"{purpose} {', '.join(missing)}, not installed here; install it with "
        f"`pip install 'tacgen[{extra}]'` (in a checkout: `make setup`)"
    )


def require_extra(extra: str, purpose: str, error: type[TacgenError]) -> None:
    """Raise ``error`` unless all packages of ``extra`` are installed."""
    if problem := missing_extra(extra, purpose):
        raise error(problem)
