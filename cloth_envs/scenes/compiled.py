"""Functions whose source is what to read, and whose compiled copy is what runs on NumPy arrays."""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import _minicloth_kernels as kernels
import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

TWINS: dict[str, Callable[..., Any]] = {}  # name -> the source, for the test that both agree


def compiled(twin: Function) -> Function:
    """Put the kernel of the same name in the place of ``twin`` where the first argument is a NumPy array.

    Only for what an environment's step is measured to need (``minicloth bench throughput``, column ``repeated``: 16 to
    27 us a step on an AVX-512 processor): a comment beside each says how many microseconds its source would add on
    NumPy arrays. On tensors, which ``array_api_compat`` knows, the source runs itself, on their device.
    """
    TWINS[twin.__name__] = twin
    kernel, array = getattr(kernels, twin.__name__), np.ndarray

    def chosen(*arguments: Any) -> Any:
        return kernel(*arguments) if type(arguments[0]) is array else twin(*arguments)

    return cast(Function, chosen)
