"""The version of the installed package, which follows the git tags."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("tacgen")
except PackageNotFoundError:  # a source tree on the path that was never installed
    __version__ = "0+not.installed"
