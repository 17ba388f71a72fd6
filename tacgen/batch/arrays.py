"""Arrays of other libraries, as NumPy or Warp sees them, and back: without a copy, by DLPack."""

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.core.errors import SensorError

NUMBERS = ("int32", "int64", "float32", "float64")


def kind_of(array: Any) -> str:
    """The library that an array is of: ``torch``, ``jax``, ``warp`` or ``numpy``."""
    library = type(array).__module__.partition(".")[0]
    kinds = {"torch": "torch", "jax": "jax", "jaxlib": "jax", "warp": "warp"}
    return kinds.get(library, "numpy")


def as_numpy(
    array: Any, name: str, shape: tuple[int, ...], dtypes: tuple[str, ...]
) -> NDArray[Any]:
    """A NumPy array that shares the memory of an array of any library.

    A number stands for all worlds alike. Raises ``SensorError`` if the array is on another device,
    of another shape or of another type.
    """
    if getattr(array, "shape", None) == () and hasattr(array, "item"):
        array = array.item()
    if isinstance(array, (int, float, list, tuple)):
        found = _from_list(array, name, shape, dtypes[-1])
    elif isinstance(array, np.ndarray):
        found = array
    elif hasattr(array, "__dlpack__"):
        try:
            found = np.from_dlpack(_detached(array))
        except (TypeError, ValueError, RuntimeError, BufferError) as error:
            msg = f"{name} cannot be read on cpu ({error}); move it there, or convert it"
            raise SensorError(msg) from None
    else:
        msg = f"{name} is a {type(array).__name__}; give a torch, JAX, Warp or NumPy array"
        raise SensorError(msg)
    if found.dtype.kind not in "fiub":
        msg = f"{name} is of {found.dtype}; convert it to numbers"
        raise SensorError(msg)
    check(name, tuple(found.shape), found.dtype.name, shape, dtypes)
    return np.ascontiguousarray(found, found.dtype.newbyteorder("="))


def check(
    name: str,
    found_shape: tuple[int, ...],
    found_dtype: str,
    shape: tuple[int, ...],
    dtypes: tuple[str, ...],
) -> None:
    """Raise ``SensorError`` unless shape and type are what they should be."""
    if found_shape != shape:
        msg = f"{name} has the shape {found_shape}; give {shape}"
        raise SensorError(msg)
    if found_dtype not in dtypes:
        msg = f"{name} is of {found_dtype}; convert it to {' or '.join(dtypes)}"
        raise SensorError(msg)


def _detached(array: Any) -> Any:
    return array.detach() if getattr(array, "requires_grad", False) else array


def _from_list(values: Any, name: str, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
    """A number for all worlds alike, or a list of one for each."""
    try:
        array = np.asarray(values, dtype)
        if not np.array_equal(array, np.asarray(values), equal_nan=dtype.startswith("float")):
            msg = f"{values!r:.60} are no {dtype}"
            raise ValueError(msg)
        return np.full(shape, array) if array.ndim == 0 else array
    except (TypeError, ValueError) as error:
        msg = f"{name}: {error}; give an array of shape {shape}"
        raise SensorError(msg) from None


def on_host(array: Any) -> NDArray[Any]:
    """Numbers of any library, of any device, for NumPy."""
    if kind_of(array) == "warp":
        return np.asarray(array.numpy())
    return np.asarray(array.cpu() if kind_of(array) == "torch" else array)


def as_kind(array: NDArray[Any], kind: str) -> Any:
    """A NumPy array as one of that library."""
    if kind == "torch":
        import torch

        return torch.from_numpy(array)
    if kind == "jax":
        import jax

        return jax.numpy.asarray(array)
    if kind == "warp":
        import warp as wp

        return wp.array(array, device="cpu", copy=False)
    return array


def free_bytes() -> int:
    """Memory that is free on this machine."""
    if sys.platform == "linux":
        with open("/proc/meminfo", encoding="ascii") as lines:
            found = next((line for line in lines if line.startswith("MemAvailable")), "")
        if found:
            return 1024 * int(found.split()[1])
    return 1 << 62


def check_memory(n: int, shape_px: tuple[int, int], device: str, free: int, at_work: int) -> int:
    """How much memory is left beside the pictures of ``n`` worlds; ``at_work`` of it is needed.

    Raises ``SensorError`` that says how many worlds fit.
    """
    each = 8 * shape_px[0] * shape_px[1] + 200
    fit = max(0, (free - at_work) // each)
    if n > fit:
        msg = (
            f"n = {n}: pictures of {shape_px[1]} × {shape_px[0]} px of so many worlds need "
            f"{n * each / 1e9:.1f} GB, and {free / 1e9:.1f} GB are free on {device}: "
            f"{fit} worlds fit; give n = {fit}, and more than one batch"
        )
        raise SensorError(msg)
    return free - n * each
