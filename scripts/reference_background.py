"""The background of a table whose gel at rest is to look as a given picture."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tacgen.optics.render import Shader
from tacgen.optics.table import LookupTable


def with_reference(
    table: LookupTable, rest_map_mm: NDArray[np.floating], reference: NDArray[np.floating]
) -> LookupTable:
    """The same table with the background for which the gel at rest renders as ``reference``.

    The background is kept to a sixteenth of a grey level, so that the file stays small.
    """
    bare = replace(
        table, background=np.zeros((*rest_map_mm.shape, 3), dtype=np.float32), effects={}
    )
    at_rest = np.empty((*rest_map_mm.shape, 3), dtype=np.float32)
    whole = (0, rest_map_mm.shape[0], 0, rest_map_mm.shape[1])
    Shader(bare).light(np.ascontiguousarray(rest_map_mm, dtype=np.float32), whole, at_rest)
    background = np.round((np.asarray(reference) - at_rest) * 16) / 16
    return replace(table, background=background.astype(np.float32))
