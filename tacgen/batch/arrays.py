"""Arrays of other libraries, as Warp sees them, and back: without a copy, by DLPack."""

import sys
from typing import Any

import numpy as np
import warp as wp

from tacgen.core.errors import SensorError


def find_device(device: Any) -> wp.Device:
    """The device of that name, or of torch; a ``SensorError`` if Warp does not have it."""
    name = str(device)
    try:
        if not name.startswith("cuda") or wp.is_cuda_available():
            return wp.get_device(name)
        msg = f"device = {name!r} is not here: Warp finds no CUDA GPU; give device='cpu'"
        raise SensorError(msg)
    except OSError as error:
        msg = f"Warp cannot keep what it compiles ({error}); set WARP_CACHE_PATH to another folder"
        raise SensorError(msg) from None
    except (ValueError, RuntimeError):
        known = ", ".join(str(one) for one in wp.get_devices())
        msg = f"device = {name!r} is not here (Warp sees {known}); give one of these, such as 'cpu'"
        raise SensorError(msg) from None


def kind_of(array: Any) -> str:
    """The library that an array is of: ``torch``, ``jax``, ``warp`` or ``numpy``."""
    if isinstance(array, wp.array):
        return "warp"
    library = type(array).__module__.partition(".")[0]
    return {"torch": "torch", "jax": "jax", "jaxlib": "jax"}.get(library, "numpy")


def as_warp(
    array: Any, name: str, shape: tuple[int, ...], device: wp.Device, dtypes: tuple[str, ...]
) -> wp.array:
    """A Warp array that shares the memory of an array of any library.

    Raises ``SensorError`` if it is on another device, of another shape or of another type.
    """
    if getattr(array, "shape", None) == () and hasattr(array, "item"):
        array = array.item()
    if isinstance(array, (int, float, list, tuple)):
        found = _from_numpy(_from_list(array, name, shape, dtypes[-1]), name).to(device)
    elif isinstance(array, np.ndarray):
        found = _from_numpy(array, name)
    elif isinstance(array, wp.array):
        found = array
    elif hasattr(array, "__dlpack__"):
        if getattr(array, "requires_grad", False):
            array = array.detach()
        try:
            found = wp.from_dlpack(array)
        except (TypeError, ValueError, RuntimeError, BufferError) as error:
            msg = f"{name} cannot be read on {device} ({error}); move it there, or convert it"
            raise SensorError(msg) from None
    else:
        msg = f"{name} is a {type(array).__name__}; give a torch, JAX, Warp or NumPy array"
        raise SensorError(msg)
    if found.device != device:
        msg = f"{name} is on {found.device}, the sensor on {device}: move it there, or make another"
        raise SensorError(msg)
    if tuple(found.shape) != shape:
        msg = f"{name} has the shape {tuple(found.shape)}; give {shape}"
        raise SensorError(msg)
    if found.dtype.__name__ not in dtypes:
        msg = f"{name} is of {found.dtype.__name__}; convert it to {' or '.join(dtypes)}"
        raise SensorError(msg)
    return found if found.is_contiguous else found.contiguous()


def _from_list(values: Any, name: str, shape: tuple[int, ...], dtype: str) -> np.ndarray[Any, Any]:
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


def _from_numpy(array: np.ndarray[Any, Any], name: str) -> wp.array:
    if array.dtype.kind not in "fiub":
        msg = f"{name} is of {array.dtype}; convert it to numbers"
        raise SensorError(msg)
    native = np.ascontiguousarray(array, array.dtype.newbyteorder("="))
    return wp.array(native, device="cpu", copy=False)


def upload(values: np.ndarray[Any, Any], device: wp.Device) -> wp.array:
    """Numbers of the host on a device."""
    return wp.array(values, device=device)


def on_host(array: Any) -> np.ndarray[Any, Any]:
    """Numbers of any library, of any device, for NumPy."""
    if isinstance(array, wp.array):
        return np.asarray(array.numpy())
    return np.asarray(array.cpu() if kind_of(array) == "torch" else array)


def as_kind(array: wp.array, kind: str) -> Any:
    """The memory of a Warp array as an array of that library."""
    if kind == "torch":
        return wp.to_torch(array, requires_grad=False)
    if kind == "jax":
        return wp.to_jax(array)
    if kind == "numpy" and array.device.is_cpu:
        return array.numpy()
    return array


def free_bytes(device: wp.Device) -> int:
    """Memory that is free on a device."""
    if device.is_cuda:
        return int(device.free_memory)
    if sys.platform == "linux":
        with open("/proc/meminfo", encoding="ascii") as lines:
            found = next((line for line in lines if line.startswith("MemAvailable")), "")
        if found:
            return 1024 * int(found.split()[1])
    return 1 << 62
