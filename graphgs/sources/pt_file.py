"""Tensors out of a torch.save file, without torch and without running anything the file asks for.

Format: a zip with NAME/data.pkl, a pickle in which tensors are calls of torch._utils._rebuild_tensor_v2 on storages
NAME/data/KEY (docs.pytorch.org, "serialization semantics"). Only those calls, OrderedDict and the storage types below
are allowed, as torch.load(weights_only=True) does; everything else in the pickle is an error.
"""

import collections
import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 50_000_000  # per member: a bound on what a small file can unpack to
_STORAGES = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "HalfStorage": np.float16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}


def read_pt(path: Path) -> Any:
    """What was saved, tensors as arrays. Raises ValueError for anything but plain containers of tensors and numbers."""
    try:
        with zipfile.ZipFile(path) as archive:
            found = [name for name in archive.namelist() if name.endswith("/data.pkl") and name.count("/") == 1]
            if len(found) != 1:
                raise ValueError("no torch.save file")
            return _Reader(archive, found[0].partition("/")[0]).load()
    except zipfile.BadZipFile:
        raise ValueError("no torch.save file, or one of a version before 1.6") from None
    except (pickle.UnpicklingError, KeyError, IndexError, TypeError, AttributeError, EOFError, RuntimeError) as error:
        raise ValueError(f"damaged, or holds more than tensors: {error}") from None


class _Reader(pickle.Unpickler):
    def __init__(self, archive: zipfile.ZipFile, root: str):
        self._archive, self._root = archive, root
        self._little = self._order() == b"little"
        super().__init__(io.BytesIO(self._member("data.pkl")))

    def find_class(self, module: str, name: str):
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if module == "torch" and name in _STORAGES:
            return np.dtype(_STORAGES[name])
        raise pickle.UnpicklingError(f"{module}.{name} is not allowed")

    def persistent_load(self, identity):
        """The storage [n] that a tensor is a view of."""
        kind, dtype, key, _, count = identity
        if kind != "storage" or not isinstance(dtype, np.dtype) or not str(key).isdecimal():
            raise pickle.UnpicklingError("a storage of unknown kind")
        values = np.frombuffer(self._member(f"data/{key}"), dtype.newbyteorder("<" if self._little else ">"))
        if len(values) < count:
            raise pickle.UnpicklingError(f"storage {key} is cut short")
        return values[:count]

    def _member(self, name: str) -> bytes:
        info = self._archive.getinfo(f"{self._root}/{name}")
        if info.file_size > MAX_BYTES:
            raise ValueError(f"{name} is larger than 50 MB")
        return self._archive.read(info)

    def _order(self) -> bytes:
        name = f"{self._root}/byteorder"  # since torch 2.1; before, always the writer's own, in practice little
        return self._member("byteorder").strip() if name in self._archive.namelist() else b"little"


def _tensor(storage: np.ndarray, offset: int, shape: tuple[int, ...], stride: tuple[int, ...], *_) -> np.ndarray:
    """A copy of the view, bounds checked."""
    shape, stride = tuple(map(int, shape)), tuple(map(int, stride))
    if len(shape) != len(stride) or min((0, offset, *shape, *stride)) < 0:
        raise pickle.UnpicklingError("a tensor of impossible shape")
    index = np.full(shape, offset, dtype=np.int64) if np.prod(shape, dtype=float) <= len(storage) else None
    if index is None:
        raise pickle.UnpicklingError("a tensor larger than its storage")
    for axis, (size, step) in enumerate(zip(shape, stride, strict=True)):
        index += np.arange(size).reshape([-1 if k == axis else 1 for k in range(len(shape))]) * step
    return storage[index].astype(storage.dtype.newbyteorder("="))
