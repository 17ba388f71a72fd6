"""Taxim's ``polycalib.npz`` as a table of ours that renders the same picture.

Taxim's table is indexed by the gradient of a map that is larger where the gel is pressed deeper,
so its direction points at the ball's centre, half a turn from ours. Its directions are cut into
bins − 1 sectors, an odd number as a rule, so half a turn is no whole number of sectors: every
sector is halved here. Its features are raw pixels, its channels BGR.
"""

import math
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.settings import RULES
from tacgen.core.errors import TableError
from tacgen.core.files import sha256_of
from tacgen.core.resources import __version__
from tacgen.core.safe_io import check_archive, read_npy, read_rgb
from tacgen.optics.table import N_FEATURES, LookupTable, save_table

CHANNELS_RGB = ("grad_b", "grad_g", "grad_r")
"""Which of its arrays holds which channel: Taxim names OpenCV's first channel r."""


def import_polycalib(path: Path, background: Path, mm_per_px: float) -> LookupTable:
    """The table in Taxim's ``polycalib.npz`` with a background image in its resolution.

    It holds ``bins`` and ``grad_r``, ``grad_g``, ``grad_b`` (bins, bins, 6), features x², y², xy,
    x, y, 1 in raw pixels, row index ⌊atan|∇h| / (½π/(bins − 1))⌋, column index
    ⌊(direction + π) / (2π/(bins − 1))⌋. ``background`` is .npy or a
    ``dataPack.npz`` with its ``f0`` (BGR, as Taxim keeps them), or an image file.

    Raises ``TableError`` if either file is not what it should be.

    Source: Taxim, branch data-collection: its calibration and rendering formulas.
    """
    if not (math.isfinite(mm_per_px) and mm_per_px > 0):
        msg = f"mm_per_px = {mm_per_px:g} must be a positive number"
        raise TableError(msg)
    path, background = Path(path), Path(background)
    taxim = _read_polycalib(path)
    reference = _read_background(background)
    height, width = reference.shape[:2]
    by_pixel = _half_turned(np.stack([taxim[name] for name in CHANNELS_RGB], axis=2))
    coefficients = by_pixel @ pixel_features_from_position((height, width))
    return LookupTable(
        coefficients=coefficients.astype(np.float32),
        background=reference.astype(np.float32),
        mm_per_px=mm_per_px,
        max_slope_rad=math.pi / 2,
        interpolation="floor",
        sensor="taxim",
        provenance={
            "made_by": f"tacgen {__version__} calibrate import",
            "data_sha256": {file.name: sha256_of(file) for file in (path, background)},
        },
    )


def convert_polycalib(path: Path, background: Path, mm_per_px: float, out: Path) -> LookupTable:
    """``import_polycalib``, written to ``out``."""
    table = import_polycalib(path, background, mm_per_px)
    save_table(table, out)
    return table


def _half_turned(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Taxim's (bins, bins, 3, 6) with directions halved and turned: (bins, 2 bins − 2, 3, 6).

    Its last column is only met at a direction of exactly π and is dropped. Where the slope is 0
    Taxim takes direction 0, and so do we, in our own sense of it: the sector there, which is
    half as wide as any and below the first slope bin, holds what Taxim holds for level gel.
    """
    sectors = table.shape[1] - 1
    level = table[0, sectors // 2]
    halved = np.repeat(table[:, :sectors], 2, axis=1)
    turned = np.roll(halved, sectors, axis=1)
    turned[0, sectors] = level
    return turned


def pixel_features_from_position(shape_px: tuple[int, int]) -> NDArray[np.float64]:
    """The matrix (6, 6) that turns coefficients of pixel features into those of position.

    A pixel's column is x = (u + ½)·width − ½, its row y = (v + ½)·height − ½; row k holds the
    k-th of x², y², xy, x, y, 1 in terms of u², v², uv, u, v, 1.
    """
    height, width = shape_px
    a, b = (width - 1) / 2, (height - 1) / 2
    return np.array(
        [
            [width**2, 0, 0, 2 * a * width, 0, a**2],
            [0, height**2, 0, 0, 2 * b * height, b**2],
            [0, 0, width * height, b * width, a * height, a * b],
            [0, 0, 0, width, 0, a],
            [0, 0, 0, 0, height, b],
            [0, 0, 0, 0, 0, 1],
        ],
        dtype=np.float64,
    )


def _read_polycalib(path: Path) -> dict[str, NDArray[np.float64]]:
    try:
        check_archive(path, RULES.max_polycalib_bytes)
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in CHANNELS_RGB if name not in archive.files]
            if missing:
                msg = (
                    f"{path}: not a Taxim table: {', '.join(missing)} missing (a tacgen table "
                    "needs no import)"
                )
                raise TableError(msg)
            arrays = {name: archive[name].astype(np.float64) for name in CHANNELS_RGB}
    except FileNotFoundError:
        msg = f"{path}: no such file; give Taxim's polycalib.npz"
        raise TableError(msg) from None
    except (OSError, ValueError, BadZipFile) as error:
        msg = f"{path}: cannot be read as a Taxim table: {error}"
        raise TableError(msg) from None
    problems = []
    for name, values in arrays.items():
        square = values.ndim == 3 and values.shape[0] == values.shape[1] >= 2
        if not square or values.shape[2] != N_FEATURES:
            problems.append(f"{path}: {name} has shape {values.shape}, not (bins, bins, 6)")
        elif not np.isfinite(values).all():
            problems.append(f"{path}: {name} holds values that are not finite")
    if len({values.shape for values in arrays.values()}) > 1:
        problems.append(f"{path}: its channels differ in their number of bins")
    TableError.raise_if(problems)
    return arrays


def _read_background(path: Path) -> NDArray[np.float64]:
    """The background (H, W, 3), RGB: an image file, an array, or the ``f0`` of a dataPack."""
    if not path.is_file():
        msg = f"{path}: no such background; give the image of the untouched gel"
        raise TableError(msg)
    image = None
    try:
        if path.suffix == ".npy":
            image = read_npy(path, RULES.max_background_bytes)
        elif path.suffix == ".npz":
            check_archive(path)
            with np.load(path, allow_pickle=False) as archive:
                image = archive["f0"]
    except KeyError:
        msg = f"{path}: has no f0; give Taxim's dataPack.npz, a .npy or an image of the gel at rest"
        raise TableError(msg) from None
    except (OSError, ValueError, BadZipFile) as error:
        msg = f"{path}: cannot be read as an array: {error}"
        raise TableError(msg) from None
    if image is None:
        return read_rgb(path, TableError).astype(np.float64)
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype.kind not in "uif":
        msg = f"{path}: is {image.dtype} of {image.shape}, not an image of shape (H, W, 3)"
        raise TableError(msg)
    return np.asarray(image[..., ::-1], dtype=np.float64)
