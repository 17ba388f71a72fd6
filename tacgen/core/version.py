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
