"""Functions that torch.compile leaves alone."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def uncompiled(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """The function, called as it is where PyTorch compiles what calls it: the graph breaks there, once, in place of
    being traced into addresses and engine calls that no graph can hold. PyTorch is not imported for that."""
    hidden: Callable[Arguments, Result] | None = None

    @functools.wraps(function)
    def call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        nonlocal hidden
        if "torch._dynamo" not in sys.modules:  # nothing is compiled without it
            return function(*args, **kwargs)
        if hidden is None:
            hidden = sys.modules["torch"].compiler.disable(function)
        return hidden(*args, **kwargs)

    return call
