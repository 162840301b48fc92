"""Functions whose source is what to read, and whose compiled copy is what runs on NumPy arrays."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import _minicloth_kernels as kernels

Function = TypeVar("Function", bound=Callable[..., Any])

TWINS: dict[str, Callable[..., Any]] = {}  # name -> the source, for the test that both agree


def compiled(twin: Function) -> Function:
    """Put the kernel of the same name in the place of ``twin`` where the first argument is a NumPy array.

    Only for what an environment's step is measured to need (``minicloth bench throughput``, column ``repeated``: 16 to
    27 us a step on an AVX-512 processor): a comment beside each says how many microseconds its source would add on
    NumPy arrays. On tensors the source itself runs, on their device.
    """
    TWINS[twin.__name__] = twin
    return cast(Function, kernels.with_source(getattr(kernels, twin.__name__), twin))
