"""The version of the installed package, which follows the git tags."""

import contextlib
import platform
import re
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version

from tacgen.core.errors import TacgenError

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


@contextlib.contextmanager
def newer_explains(where: object, made_by: object) -> Iterator[None]:
    """Say of a file ``where`` that a newer tacgen made it, if that is why it cannot be read.

    ``made_by`` is the version that the file states, if it states one.
    """
    try:
        yield
    except TacgenError as error:
        found, own = (_release(text) for text in (made_by, __version__))
        if not found or found <= own:
            raise
        text = f"made by a newer tacgen ({made_by}, this is {__version__}); upgrade tacgen"
        msg = f"{where}: {text}"
        raise type(error)(msg) from None


def _release(text: object) -> tuple[int, ...]:
    numbers = re.match(
        r"(\d{1,9})\.(\d{1,9})(?:\.(\d{1,9}))?", text if isinstance(text, str) else ""
    )
    return tuple(int(number or 0) for number in numbers.groups()) if numbers else ()
