"""Files of strangers: what they say of themselves is looked at before it is believed."""

import io
import math
import warnings
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import cv2
import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from tacgen.core.errors import TacgenError
from tacgen.core.progress import print_once

MAX_SIDE_PX, MAX_PIXELS = 8192, 1 << 25  # larger than any tactile camera's image
MAX_IMAGE_BYTES = 1 << 28
UNFOLDED, LEAST_UNFOLDED_BYTES = 50, 1 << 27  # no measured picture is so empty
MAX_ARCHIVE_BYTES = 1 << 30  # what the arrays of an archive may take together

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")

_ORIENTATION = 0x0112  # the EXIF tag; 1 is upright
_TURNS = {2: (0, True), 3: (2, False), 4: (2, True), 5: (3, True), 6: (3, False), 7: (1, True),
          8: (1, False)}  # fmt: skip
"""Quarter turns to the left, then whether left and right change places, by EXIF orientation."""

_COARSE_JPEG = 3
"""Step, in eighths of a grey level, of a block's mean in a JPEG of quality 90; a coarser one
rounds away what a light touch changes."""

_LEAST_LEVELS = 32.0  # no picture of grey levels 0 to 255 is darker than this everywhere


def read_rgb(path: Path, error: type[TacgenError] = TacgenError) -> NDArray[np.uint8]:
    """An image file as RGB (H, W, 3) uint8.

    Raises ``error`` if it is missing, no image, or its values are not surely those of a colour
    picture (see ``rgb_of_array``).
    """
    if not path.is_file():
        msg = f"{path}: no such file; give PNG or JPEG"
        raise error(msg)
    try:
        if path.stat().st_size > MAX_IMAGE_BYTES:
            msg = f"{path}: larger than {MAX_IMAGE_BYTES >> 20} MiB, which no picture is"
            raise error(msg)
        data = path.read_bytes()
    except OSError as problem:
        msg = f"{path}: cannot be read: {problem.strerror}"
        raise error(msg) from None
    return decode_rgb(data, str(path), error, kind_of=str(path.parent))


def decode_rgb(
    data: bytes, where: str, error: type[TacgenError] = TacgenError, *, kind_of: str = ""
) -> NDArray[np.uint8]:
    """The bytes of an image file as RGB (H, W, 3) uint8; ``where`` and ``kind_of`` name them.

    The header is read first: a small file can unfold into gigabytes. A turn that EXIF asks for is
    made. What is not as usual is said once for all of ``kind_of``. Raises as ``read_rgb``.
    """
    from PIL import Image, UnidentifiedImageError

    found: NDArray[Any] | None = None
    notes: list[str] = []
    turn = 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data)) as image:
                if max(image.size) <= MAX_SIDE_PX and math.prod(image.size) <= MAX_PIXELS:
                    _refuse_kind(image, where, error)
                    if _is_cut_short(image.format, data):
                        msg = f"{where}: is cut short or damaged; copy it again from its source"
                        raise error(msg)
                    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
                    notes, turn = _about(image, data)
    except (OSError, ValueError, SyntaxError, UnidentifiedImageError, Image.DecompressionBombError,
            cv2.error):  # fmt: skip
        found = None
    if found is None:
        problem = f"cannot be read as an image of at most {MAX_SIDE_PX} pixels a side, "
        problem += f"{MAX_PIXELS >> 20} million in all"
        msg = f"{where}: {problem}; give PNG or JPEG"
        raise error(msg)
    if found.ndim == 3:  # blue comes first
        found = found[..., ::-1] if found.shape[2] == 3 else found[..., [2, 1, 0, 3]]
    for note in notes:
        print_once(f"{kind_of or where}: {note}")
    rgb = rgb_of_array(found, where, error, kind_of=kind_of)
    if turn not in _TURNS:
        return rgb
    quarters, mirrored = _TURNS[turn]
    rgb = np.rot90(rgb, quarters)
    return np.ascontiguousarray(rgb[:, ::-1] if mirrored else rgb)


def rgb_of_array(
    values: NDArray[Any],
    where: str,
    error: type[TacgenError] = TacgenError,
    *,
    kind_of: str = "",
) -> NDArray[np.uint8]:
    """A picture (H, W), (H, W, 3) or (H, W, 4) of any number type as RGB (H, W, 3) uint8.

    Whole numbers of 8 bits stay; 16 bits are scaled where they reach the upper half of their range
    or hold 8 bits; floats where they are of 0 to 1 or of 0 to 255. Grey is repeated; opaque alpha
    is left out.

    Raises ``error``, stating type and range, for other numbers: fewer bits in 16, depth in floats,
    transparent pixels.
    """
    values = np.asarray(values)
    if values.dtype.kind not in "uif" or values.ndim not in (2, 3) or not values.size:
        msg = f"{where}: is {values.dtype} of shape {values.shape}, not a picture (H, W, 3)"
        raise error(msg)
    if values.ndim == 3 and values.shape[2] not in (1, 3, 4):
        msg = f"{where}: has shape {values.shape}; give a picture (H, W, 3), channels last"
        raise error(msg)
    if values.ndim == 3 and values.shape[2] == 4:
        full = 255 if values.dtype == np.uint8 else max(values[..., 3].max(), 1)
        clear = float((values[..., 3] < full).mean())
        if clear > 0:
            share = f"{clear:.1%} of its pixels are transparent"
            msg = f"{where}: {share}, so their colour is not known; save it without alpha"
            raise error(msg)
        values = values[..., :3]
    if values.ndim == 2 or values.shape[2] == 1:
        if values.dtype != np.uint8:
            kind = f"one channel of {values.dtype} from {values.min():g} to {values.max():g}"
            msg = f"{where}: {kind} is a depth map or raw data; give a picture of 8 bits in colour"
            raise error(msg)
        print_once(f"{kind_of or where}: one grey channel, taken for red, green and blue")
        values = np.repeat(values.reshape(*values.shape[:2], 1), 3, axis=2)
    levels, note = _eight_bits(values)
    if levels is None:
        kind = f"{values.dtype} from {values.min():g} to {values.max():g}"
        fix = "save it with 8 bits a channel, or scaled to the type's full range"
        msg = f"{where}: {kind}: what stands for white is not known; {fix}"
        raise error(msg)
    if note:
        print_once(f"{kind_of or where}: {note}")
    return np.ascontiguousarray(levels)


def _eight_bits(values: NDArray[Any]) -> tuple[NDArray[np.uint8] | None, str]:
    """Grey levels, or None where white is not known; and what was done, if anything."""
    if values.dtype == np.uint8:
        return values, ""
    smallest, largest = float(values.min()), float(values.max())
    levels: NDArray[Any] | None = None
    note = f"{values.dtype} of 0 to 255"
    if not smallest >= 0:  # nor where a number is missing
        return None, ""
    if values.dtype == np.uint16:
        low, high = values & 255, values >> 8
        if not low.any() or np.array_equal(low, high):
            levels, note = high, "8 bits in 16: the upper byte is taken"
        elif largest > np.iinfo(np.uint16).max // 2:
            levels, note = values / 257.0, "16 bits, scaled to 8 by 1/257"
    elif values.dtype.kind == "f" and 0 < largest <= 1 + 1e-6:  # 1.0 may be rounded up
        levels, note = np.minimum(values, 1.0) * 255.0, f"{values.dtype} of 0 to 1, times 255"
    elif _LEAST_LEVELS <= largest <= 255:
        levels = values
    return None if levels is None else np.rint(levels).astype(np.uint8), note


def _refuse_kind(image: Any, where: str, error: type[TacgenError]) -> None:
    """Refuse what an opened image's header shows to be no single colour picture."""
    if getattr(image, "n_frames", 1) > 1:
        msg = f"{where}: holds {image.n_frames} pictures; save the one that is meant as PNG"
        raise error(msg)
    if image.mode in ("1", "CMYK", "LAB", "HSV"):
        msg = f"{where}: is of the kind {image.mode}, not red, green and blue; save it as RGB"
        raise error(msg)


def _is_cut_short(kind: str | None, data: bytes) -> bool:
    """Whether the bytes of a PNG or a JPEG end early, or a PNG's are not what its sums say.

    The decoders write words of their own on it, and fill up the rest of a JPEG with grey.
    """
    if kind == "JPEG":
        return b"\xff\xd9" not in data[data.rfind(b"\xff\xda") :]
    place = 8 if kind == "PNG" else len(data)
    while place < len(data):
        length, name = int.from_bytes(data[place : place + 4]), data[place + 4 : place + 8]
        end = place + 8 + length
        total = data[end : end + 4]
        if len(total) < 4 or zlib.crc32(memoryview(data)[place + 4 : end]) != int.from_bytes(total):
            return True
        if name == b"IEND":
            return False
        place = end + 4
    return kind == "PNG"


def _about(image: Any, data: bytes) -> tuple[list[str], int]:
    """What is worth knowing of an opened image, and its EXIF orientation."""
    notes, turn = [], 1
    if image.mode in ("P", "PA"):
        notes.append("a palette of at most 256 colours: small slopes are rounded away; save as RGB")
    tables = getattr(image, "quantization", None)
    if tables and max(table[0] for table in tables.values()) > _COARSE_JPEG:
        notes.append("JPEG below quality 90: small slopes are rounded away; PNG keeps them")
    # A PNG's EXIF may stand at its end, and PIL decodes the picture to get there; TIFF comes turned
    if image.format != "TIFF" and (image.format != "PNG" or b"eXIf" in data):
        turn = int(image.getexif().get(_ORIENTATION, 1))
        if turn in _TURNS:
            notes.append(f"turned as its EXIF orientation {turn} says")
    return notes, turn


def refuse_packed(path: Path) -> None:
    """Raise ``ValueError`` for an archive that unfolds; one of another kind is left alone."""
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > path.stat().st_size:
                msg = "it is larger than its file, which is never so"
                raise ValueError(msg)


def check_archive(path: Path, most_bytes: int = MAX_ARCHIVE_BYTES) -> None:
    """See that every array of a .npz is as large as it says, and all of them not too large.

    The sizes are those that the archive states, looked at before anything is unpacked.

    Raises ``ValueError`` if it is not so; ``OSError`` if there is no such file.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            size = sum(member.file_size for member in members)
            if size > most_bytes:
                msg = f"its arrays take more than {most_bytes >> 20} MiB"
                raise ValueError(msg)
            if size > max(UNFOLDED * path.stat().st_size, LEAST_UNFOLDED_BYTES):
                msg = f"it unfolds to more than {UNFOLDED} times its size"
                raise ValueError(msg)
            for member in members:
                with archive.open(member) as file:
                    _check_array(file, member.filename, member.file_size)
                    while file.read(1 << 20):  # the checksum is that of the whole
                        pass
    except (OSError, ValueError):
        raise
    except Exception as error:  # zipfile and numpy raise whatever damage leads them to
        msg = f"it is damaged: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
        raise ValueError(msg) from None


def read_npy(path: Path, most_bytes: int) -> NDArray[Any]:
    """The array of a .npy file, whose stated size is looked at before anything is read.

    Raises ``ValueError`` if it is not as large as it says, larger than ``most_bytes``, or holds
    Python objects; ``OSError`` if there is no such file.
    """
    size = path.stat().st_size
    if size > most_bytes:
        msg = f"it takes more than {most_bytes >> 20} MiB"
        raise ValueError(msg)
    try:
        with path.open("rb") as file:
            _check_array(file, path.name, size)
        return np.asarray(np.load(path, allow_pickle=False))
    except (OSError, ValueError):
        raise
    except Exception as error:  # as above
        msg = f"it is damaged: {type(error).__name__}"
        raise ValueError(msg) from None


def _check_array(file: IO[bytes], name: str, size: int) -> None:
    version = npy.read_magic(file)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read(file)
    n_bytes = dtype.itemsize * math.prod(map(int, shape))
    # Objects are pickled and refused by whoever reads them; they have no size of their own.
    if not dtype.hasobject and n_bytes != size - file.tell():
        msg = f"{name} says {shape} of {dtype}, which is not what is there"
        raise ValueError(msg)
