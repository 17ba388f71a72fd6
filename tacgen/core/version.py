"""The version of the installed package, which follows the git tags."""

import platform
from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("tacgen")
except PackageNotFoundError:  # a source tree on the path that was never installed
    __version__ = "0+not.installed"


def versions(*packages: str) -> dict[str, str]:
    """Versions of tacgen, of these packages and of Python, for the record of a result."""
    found = {name: version(name) for name in packages}
    return {"tacgen": __version__, **found, "python": platform.python_version()}


def newer_problem(found: object, known: int) -> str:
    """What is wrong with a file of schema ``found`` where ``known`` is read; or nothing."""
    if found == known:
        return ""
    if isinstance(found, int) and found > known:
        return f"made by a newer tacgen (schema {found}, this one reads {known}); upgrade tacgen"
    return f"of an unknown schema {found!r}; this tacgen reads {known}"
