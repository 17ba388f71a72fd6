"""numba's compiler; a warning where it can keep nothing that it has compiled."""

import os
from pathlib import Path

from tacgen.core.caches import TEMPORARY_FOLDER, can_write
from tacgen.core.progress import LOG

_PACKAGE = Path(__file__).parents[1]
KEEPS_NOTHING = bool(TEMPORARY_FOLDER) and not (
    os.environ.get("NUMBA_CACHE_DIR") or can_write(_PACKAGE / "__pycache__")
)
if KEEPS_NOTHING:
    LOG.warning(
        "nothing that is compiled can be kept (neither %s nor the user's cache can be written), so "
        "each start takes some 20 s longer; set NUMBA_CACHE_DIR to a folder that can",
        _PACKAGE,
    )

from numba import njit  # noqa: E402

__all__ = ["KEEPS_NOTHING", "njit"]
