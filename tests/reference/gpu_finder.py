"""The searches on a GPU for tests that are written with NumPy: arrays go there, answers come back."""

import dataclasses

import fastcollide as fc
import numpy as np
import pytest

no_gpu = pytest.mark.skipif(len(fc.devices()) == 1, reason="no GPU that this build can use")


class GpuFinder:
    def __init__(self):
        self._there = pytest.importorskip("cupy").asarray
        self._finder = fc.ContactFinder()

    def find_contacts(self, *arguments, **options):
        return self._call(self._finder.find_contacts, arguments, options)

    def find_neighbors(self, *arguments, **options):
        return self._call(self._finder.find_neighbors, arguments, options)

    def _call(self, search, arguments, options):
        found = search(*map(self._to, arguments), **{name: self._to(value) for name, value in options.items()})
        if not dataclasses.is_dataclass(found):
            return self._back(found)
        back = {field.name: self._back(getattr(found, field.name)) for field in dataclasses.fields(found)}
        return dataclasses.replace(found, **back)

    def _to(self, value):
        return self._there(value) if isinstance(value, np.ndarray) else value

    @staticmethod
    def _back(value):
        return fc.to_numpy(value) if hasattr(value, "__dlpack__") else value
