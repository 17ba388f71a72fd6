"""Whether this Python can make tacgen's environment; `make` runs it, with any Python 3."""

import importlib.util
import sys

if sys.version_info < (3, 11):  # noqa: UP036
    sys.exit(
        f"tacgen needs Python 3.11 or newer; {sys.executable} is {sys.version.split()[0]}. "
        "Name another: make PYTHON=/path/to/python3.12"
    )
if not all(map(importlib.util.find_spec, ("venv", "ensurepip"))):
    sys.exit(
        f"{sys.executable} has no module venv; install it (Debian and Ubuntu: `apt install "
        f"python3.{sys.version_info[1]}-venv`), or name another Python: make PYTHON=/path/to/python"
    )
