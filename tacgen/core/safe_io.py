"""Files of strangers: what they say of their own size is looked at before it is believed."""

import math
import warnings
import zipfile
from pathlib import Path
from typing import IO

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tacgen.core.errors import TacgenError

MAX_SIDE_PX = 8192  # larger than any tactile camera's image
MAX_ARCHIVE_BYTES = 4 << 30  # what the arrays of an archive may take together


def read_bgr(path: Path) -> NDArray[np.uint8] | None:
    """An image file as (H, W, 3), blue first; None where it is none, or larger than allowed.

    The header is read first: a small file can unfold into gigabytes.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(path) as image:
                sides = image.size
    except (OSError, ValueError, SyntaxError, UnidentifiedImageError, Image.DecompressionBombError):
        return None
    if max(sides) > MAX_SIDE_PX:
        return None
    found = cv2.imread(str(path), cv2.IMREAD_COLOR)
    return None if found is None else np.asarray(found, np.uint8)


def read_rgb(path: Path, error: type[TacgenError] = TacgenError) -> NDArray[np.uint8]:
    """An image file as RGB (H, W, 3) uint8; raises ``error`` if it is missing or no image."""
    bgr = read_bgr(path) if path.is_file() else None
    if bgr is None:
        problem = f"cannot be read as an image of at most {MAX_SIDE_PX} pixels a side"
        msg = f"{path}: {problem if path.is_file() else 'no such file'}; give PNG or JPEG"
        raise error(msg)
    return np.ascontiguousarray(bgr[..., ::-1])


def check_archive(path: Path) -> None:
    """See that every array of a .npz is as large as it says, and all of them not too large.

    Raises ``ValueError`` if it is not so; ``OSError`` if there is no such file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            total = 0
            for member in archive.infolist():
                with archive.open(member) as file:
                    total += _array_bytes(file, member)
                    while file.read(1 << 20):  # the checksum is that of the whole
                        pass
                if total > MAX_ARCHIVE_BYTES:
                    msg = f"its arrays take more than {MAX_ARCHIVE_BYTES >> 30} GiB"
                    raise ValueError(msg)
    except (OSError, ValueError):
        raise
    except Exception as error:  # zipfile and numpy raise whatever damage leads them to
        msg = f"it is damaged: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
        raise ValueError(msg) from None


def _array_bytes(file: IO[bytes], member: zipfile.ZipInfo) -> int:
    version = npy.read_magic(file)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(file)
    n_bytes = dtype.itemsize * math.prod(map(int, shape))
    # Objects are pickled and refused by whoever reads them; they have no size of their own.
    if not dtype.hasobject and n_bytes != member.file_size - file.tell():
        msg = f"{member.filename} says {shape} of {dtype}, which is not what is there"
        raise ValueError(msg)
    return member.file_size if dtype.hasobject else n_bytes
