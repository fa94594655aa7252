"""Arrays in the memory of a GPU, for any library that knows DLPack or the CUDA array interface."""

from __future__ import annotations

from typing import Any

import numpy as np


class DeviceArray:
    """An array on a GPU that shares the memory of a world: ``cupy.asarray(a)``, ``torch.as_tensor(a)``,
    ``torch.from_dlpack(a)``, ``jax.dlpack.from_dlpack(a)`` copy nothing.

    The world's work on it is complete whenever one of its calls has returned; its next call waits for whatever the
    user's libraries still do on that GPU. The memory lives as long as any array that shares it. Worlds make these;
    nobody else needs to.

    Attributes:
        shape: number of elements along each axis.
        dtype: NumPy's type of the elements.
        device: "cuda:N".
    """

    def __init__(self, inner: Any, pointer: int, shape: tuple[int, ...], typestr: str, device_id: int) -> None:
        self._inner = inner
        self._pointer = pointer
        self._typestr = typestr
        self.shape = shape
        self.dtype = np.dtype(typestr)
        self.device = f"cuda:{device_id}"

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape))

    @property
    def nbytes(self) -> int:
        """Size [bytes]."""
        return self.size * self.dtype.itemsize

    def __len__(self) -> int:
        return self.shape[0]

    def __repr__(self) -> str:
        return f"DeviceArray(shape={self.shape}, dtype={self.dtype}, device={self.device!r})"

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        # stream None: the data are ready, nobody has to wait.
        return {
            "shape": self.shape,
            "typestr": self._typestr,
            "data": (self._pointer if self.size else 0, False),
            "strides": None,
            "stream": None,
            "version": 3,
        }

    def __dlpack__(self, **options: Any) -> Any:
        return self._inner.__dlpack__(**options)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._inner.__dlpack_device__()
