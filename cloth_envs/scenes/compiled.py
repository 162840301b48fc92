"""Functions whose NumPy source is what to read, and whose compiled copy is what runs."""

from collections.abc import Callable
from typing import Any, TypeVar

import _minicloth_kernels as kernels

Function = TypeVar("Function", bound=Callable[..., Any])

TWINS: dict[str, Callable[..., Any]] = {}  # name -> the NumPy source, for the test that both agree


def compiled(twin: Function) -> Function:
    """Put the kernel of the same name in the place of ``twin``.

    Only for what an environment's step is measured to need (``minicloth bench throughput``, column ``repeated``: 16 to
    27 us a step on an AVX-512 processor): a comment beside each says how many microseconds its NumPy source would add.
    """
    TWINS[twin.__name__] = twin
    return getattr(kernels, twin.__name__)
