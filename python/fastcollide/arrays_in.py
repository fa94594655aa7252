"""Arrays of any library as the engine takes them: an address, a type, steps, a device. Nothing is copied on a GPU."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from fastcollide import _core
from fastcollide.device_array import DeviceArray
from fastcollide.errors import InvalidValue

Described = tuple[int, bool, int, int, int, int]


@dataclass(frozen=True)
class ArrayIn:
    """An array that is held while the engine reads it.

    address, shape, strides (in bytes), dtype; device: number of a CUDA device, or -1 for the host; kind: the library
    that it came from, which is also that of the result.
    """

    owner: Any
    address: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]
    dtype: np.dtype[Any]
    device: int
    kind: str

    def described(self) -> Described:
        size = self.dtype.itemsize
        steps = [stride // size for stride in self.strides] + [1]
        return self.address, self.dtype == np.float64, self.shape[0], steps[0], steps[1], self.device


def kind_of(value: Any) -> str:
    """ "numpy", "torch", "cupy", "jax", or "other": by its module, so that none has to be imported."""
    root = type(value).__module__.partition(".")[0]
    return {"numpy": "numpy", "torch": "torch", "cupy": "cupy", "jax": "jax", "jaxlib": "jax"}.get(root, "other")


def is_number_on_host(value: Any) -> bool:
    """An array of no dimensions that can be read without a copy from a GPU."""
    if getattr(value, "shape", None) != ():
        return False
    if kind_of(value) == "torch":
        return value.device.type == "cpu"
    if hasattr(value, "__cuda_array_interface__"):
        return False
    return not hasattr(value, "__dlpack_device__") or value.__dlpack_device__()[0] == 1


def array_in(field: str, value: Any, columns: int, host_dtype: DTypeLike | None = None) -> ArrayIn:
    """The array behind a value: shape (n, columns), or (n,) for columns = 0.

    On the host float32 and float64 are taken as they lie, other real numbers are converted (host_dtype: to this type
    where it is wider). Raises InvalidValue for a wrong shape or type.
    """
    array = _on_gpu(field, value) or _on_host(field, value, host_dtype)
    expected = f"(n, {columns})" if columns else "(n,)"
    if len(array.shape) != (2 if columns else 1) or (columns and array.shape[1] != columns):
        raise InvalidValue(f"{field}: found an array of shape {array.shape}; allowed: shape {expected}", field)
    if array.dtype not in (np.float32, np.float64):
        raise InvalidValue(f"{field}: found an array of {array.dtype}; allowed: float32 or float64", field)
    if any(stride % array.dtype.itemsize for stride in array.strides) or array.address % array.dtype.itemsize:
        raise InvalidValue(f"{field}: found numbers that are not aligned to their size; allowed: aligned ones", field)
    return array


def _on_host(field: str, value: Any, dtype: DTypeLike | None) -> ArrayIn:
    kind = kind_of(value)
    if kind == "torch":
        value = value.detach()
    if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
        raise InvalidValue(f"{field}: found an array with masked numbers; allowed: one without", field)
    try:
        if kind == "torch":
            array = value.numpy()
        elif kind == "other" and hasattr(value, "__dlpack__") and not hasattr(value, "__array__"):
            array = np.from_dlpack(value)
        else:
            array = np.asarray(value)
    except (BufferError, TypeError, ValueError, RuntimeError) as error:
        raise InvalidValue(f"{field}: found no array of numbers ({error}); allowed: an array", field) from None
    if array.dtype.kind not in "fiu" or array.dtype.itemsize > 8:
        raise InvalidValue(f"{field}: found an array of {array.dtype}; allowed: float32 or float64", field)
    narrow = array.dtype.kind == "f" and array.dtype.itemsize <= 4
    wanted = np.result_type(np.float32 if narrow else np.float64, dtype or np.float32)
    array = array.astype(wanted.newbyteorder("="), copy=False)
    if not array.flags.aligned:
        array = array.copy()
    return ArrayIn(array, array.ctypes.data, array.shape, array.strides, array.dtype, -1, kind)


def _on_gpu(field: str, value: Any) -> ArrayIn | None:
    kind = kind_of(value)
    if kind == "torch":
        return _torch_on_gpu(field, value.detach()) if value.device.type == "cuda" else None
    interface = None if kind == "numpy" else getattr(value, "__cuda_array_interface__", None)
    if interface is not None:
        address = interface["data"][0] or 0
        dtype = np.dtype(interface["typestr"])
        shape = tuple(interface["shape"])
        strides = interface.get("strides") or tuple(
            int(np.prod(shape[axis + 1 :], dtype=np.int64)) * dtype.itemsize for axis in range(len(shape))
        )
        device = _core.cuda_device_of(address) if address else _device_number(value)
        return ArrayIn(value, address, shape, tuple(strides), dtype, device, kind)
    if hasattr(value, "__dlpack_device__") and value.__dlpack_device__()[0] != 1:
        held, address, shape, strides, code, bits, device = _core.describe_dlpack(value)
        dtype = np.dtype(f"{'iuf'[code]}{bits // 8}") if code <= 2 else np.dtype(object)
        return ArrayIn(held, address, tuple(shape), tuple(s * bits // 8 for s in strides), dtype, device, kind)
    return None


def _torch_on_gpu(field: str, tensor: Any) -> ArrayIn:
    name = str(tensor.dtype).removeprefix("torch.")
    if name not in ("float32", "float64"):  # NumPy has no word for some of the others
        raise InvalidValue(f"{field}: found an array of {name}; allowed: float32 or float64", field)
    dtype = np.dtype(name)
    try:
        address, steps = tensor.data_ptr(), tensor.stride()
    except RuntimeError as error:  # sparse, or a stand-in of vmap or grad: no numbers lie anywhere
        raise InvalidValue(f"{field}: found no array of numbers ({error}); allowed: an array", field) from None
    strides = tuple(step * dtype.itemsize for step in steps)
    return ArrayIn(tensor, address, tuple(tensor.shape), strides, dtype, tensor.device.index, "torch")


def _device_number(value: Any) -> int:
    return value.__dlpack_device__()[1] if hasattr(value, "__dlpack_device__") else 0


def current_stream(array: ArrayIn) -> int:
    """The stream that the caller's library queues its work on; the default one where it names none."""
    if array.device < 0:
        return 0
    if array.kind == "torch":
        return sys.modules["torch"].cuda.current_stream(array.device).cuda_stream
    if array.kind == "cupy":
        return sys.modules["cupy"].cuda.get_current_stream(array.device).ptr
    stream = (getattr(array.owner, "__cuda_array_interface__", None) or {}).get("stream")
    # 1 and 2 name the default streams in the array interface and to the CUDA runtime alike.
    return stream or 1


def like(array: ArrayIn, result: Any) -> Any:
    """A result of the engine as an array of the caller's library, sharing the memory."""
    if array.kind == "torch":
        torch = sys.modules["torch"]
        return torch.from_dlpack(result) if array.device >= 0 else torch.from_numpy(result)
    if array.kind == "cupy":
        return sys.modules["cupy"].asarray(result)
    if array.kind == "jax":
        jax = sys.modules["jax"]
        return jax.dlpack.from_dlpack(result) if array.device >= 0 else jax.numpy.asarray(result)
    assert isinstance(result, (np.ndarray, DeviceArray))
    return result
